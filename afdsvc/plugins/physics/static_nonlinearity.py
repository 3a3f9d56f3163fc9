"""Static nonlinearity: a curved characteristic of an input or of a flow between states."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_input, at_state


def curve(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a2 w^2 + a3 w^3`` in units of the rms ``r``: ``w = z / r``, times r."""
    w = z[0] / p[2]
    out[0] += (p[0] * w * w + p[1] * w * w * w) * p[2]


def _parts(port: Size, unit: str, name: str, scale: float) -> dict[str, Any]:
    r = port.rms
    return {
        "physics": name, "family": "input curve",
        "parameters": [
            Coefficient("quadratic share", unit, -20 * scale, 20 * scale, 0.05 * scale, linear=True),
            Coefficient("cubic share", unit, -20 * scale, 20 * scale, 0.05 * scale, linear=True),
            Coefficient("reference", port.unit, r, r, r, nuisance=True),
        ],
        "starts": [(0.0, 0.0, r)],
        "predicts": "even and odd distortion that grows with the square and the cube of the level",
        "refuted_by": "distortion whose share falls as the level rises",
    }


class StaticNonlinearity:
    """A curved characteristic at every input, and in every state of a machine without axes of motion."""

    name = "static_nonlinearity"
    summary = "a smooth curved characteristic without memory"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, and per state where no axis is known."""
        for port in machine.inputs:
            yield at_input(port, curve, **_parts(port, "", self.name, 1.0))
        if machine.axes or machine.plant is None:
            return
        for port in machine.states:
            rate = max(abs(float(machine.plant.A[port.index, port.index])), 1e-3 * machine.bandwidth)
            yield at_state(port, curve, [Signal("x", port.index)], **_parts(port, "1/s", self.name, rate))
