"""A gain that follows the position: the force of an actuator depends on where the axis is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import at_drive, at_state, constant, converter, placed, state, velocity


def geared(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``b u (c d + e d^2)``, ``d = (q - mean) / rms``; ``p = (c, e, mean, rms, b)``."""
    d = (z[1] - p[2]) / p[3]
    out[0] += p[4] * z[0] * (p[0] + p[1] * d) * d


def through_coil(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``b i (c d + e d^2)`` on the axis, and ``h v (c d + e d^2)`` where its velocity induces what opposes ``i``; ``p = (c, e, mean, rms, b, h)``."""
    d = (z[1] - p[2]) / p[3]
    share = (p[0] + p[1] * d) * d
    out[0] += p[4] * z[0] * share
    if len(out) > 1:
        out[1] += p[5] * z[2] * share


class GainFollowsPosition:
    """An actuator on every axis whose gain rises or falls along the way, or the coil that is a state of the model: there the voltage that the motion
    induces follows the position, too."""

    name = "gain_follows_position"
    summary = "an actuator gain that depends on the position of the axis"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis with a position and an input, or a state in its place."""
        for axis, q in placed(machine):
            if axis.input is not None:
                yield at_drive(axis, machine, geared, [Signal("u", axis.input), state(q)], notes={"variant": axis.name}, **self._words(q, axis.gain))
            elif (coil := converter(machine, axis)) and machine.plant:
                gain, induced = (float(machine.plant.A[i, j]) for i, j in ((axis.rate.index, coil.index), (coil.index, axis.rate.index)))
                writes = [velocity(axis), state(coil)] if induced else [velocity(axis)]
                yield at_state(axis.rate, through_coil, [state(coil), state(q), velocity(axis)], writes, notes={"variant": coil.name}, **self._words(q, gain, induced))

    def _words(self, q: Size, *gains: float) -> dict[str, Any]:
        return {
            "physics": self.name, "family": "follows position",
            "parameters": [
                Coefficient("rise at the rms", "", -5.0, 5.0, 0.02, linear=True),
                Coefficient("bend at the rms", "", -5.0, 5.0, 0.02, linear=True),
                constant("middle", q.unit, q.mean), constant("rms", q.unit, q.rms), *(constant("gain", "", g) for g in gains),
            ],
            "starts": [(0.0, 0.0, q.mean, q.rms, *gains)],
            "predicts": "a residual in proportion to input times position", "refuted_by": "a gain that is the same at every position",
        }
