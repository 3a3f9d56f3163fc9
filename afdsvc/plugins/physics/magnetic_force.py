"""Magnetic force: a pull that goes with the square of current over gap, linear in the model."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_force, constant, converter, placed, quantity, state


def single(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """One magnet, ``b i0 / 2 (1 + i / i0)^2 / (1 - s q / g)^2`` less its straight part, i and q about their means.

    ``p = (i0, g, b, s, means)``, s the side it pulls to.
    """
    i, q = (z[0] - p[4]) / p[0], p[3] * (z[1] - p[5]) / p[1]
    gap = max(1.0 - q, 0.05)
    out[0] += 0.5 * p[2] * p[0] * ((1.0 + i) * (1.0 + i) / (gap * gap) - 1.0 - 2.0 * i - 2.0 * q)


def pair(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Two magnets that pull against each other, the current added to one and taken from the other; as `single`."""
    i, q = (z[0] - p[4]) / p[0], p[3] * (z[1] - p[5]) / p[1]
    more, less = (1.0 + i) / max(1.0 - q, 0.05), (1.0 - i) / max(1.0 + q, 0.05)
    out[0] += 0.25 * p[2] * p[0] * (more * more - less * less - 4.0 * i - 4.0 * q)


class MagneticForce:
    """One magnet, or two against each other, about an operating point; on every axis driven by a current or a voltage, or by a current that is a
    state, whose position is not an angle: it is a gap."""

    name = "magnetic_force"
    summary = "a pull that goes with the square of current over gap"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per axis with a position along a line that is driven electrically."""
        for axis, q in placed(machine):
            port, coil = None if axis.input is None else machine.inputs[axis.input], converter(machine, axis)
            for law, notes in ((single, {}), (pair, {"variant": "pair", "of": ""})) if quantity(q.unit) != "angle" else ():
                if port and quantity(port.unit) in ("current", "voltage"):
                    yield self._on(axis, q, port, Signal("u", port.index), axis.gain, law, notes)
                elif coil and machine.plant and quantity(coil.unit) == "current":
                    yield self._on(axis, q, coil, state(coil), float(machine.plant.A[axis.rate.index, coil.index]), law, notes)

    def _on(self, axis: Axis, q: Size, port: Size, drive: Signal, gain: float, law: Any, notes: dict[str, str]) -> Hypothesis:
        side = 1.0 if gain >= 0 else -1.0
        return at_force(
            axis, law, [drive, state(q)], physics=self.name, family="stiffness", notes=notes,
            parameters=[
                Coefficient("bias", port.unit, 0.5 * port.rms, 100 * port.peak, 0.1 * port.rms),
                Coefficient("gap", q.unit, 1.05 * q.reach, 1e3 * q.reach, 0.1 * q.reach),
                constant("gain", "", gain), constant("side", "", side), constant("mean current", "", port.mean), constant("mean position", "", q.mean),
            ],
            starts=[(b * port.reach, g * q.reach, gain, side, port.mean, q.mean) for b in (1.0, 4.0) for g in (1.5, 5.0)],
            predicts="a gain and a stiffness that change with the current and the gap together",
            refuted_by="a gain that is the same at every position and level",
        )
