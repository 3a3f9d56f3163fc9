"""A gain that follows the position: the force of an actuator depends on where the axis is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_drive, constant, placed, state


def geared(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``b u (c d + e d^2)``, ``d = (q - mean) / rms``; ``p = (c, e, mean, rms, b)``."""
    d = (z[1] - p[2]) / p[3]
    out[0] += p[4] * z[0] * (p[0] + p[1] * d) * d


class GainFollowsPosition:
    """An actuator on every axis whose gain rises or falls along the way."""

    name = "gain_follows_position"
    summary = "an actuator gain that depends on the position of the axis"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis with a position and an input."""
        for axis, q in placed(machine):
            if axis.input is None:
                continue
            yield at_drive(
                axis, machine, geared, [Signal("u", axis.input), state(q)], physics=self.name, family="follows position",
                parameters=[
                    Coefficient("rise at the rms", "", -5.0, 5.0, 0.02, linear=True),
                    Coefficient("bend at the rms", "", -5.0, 5.0, 0.02, linear=True, nuisance=True),
                    constant("middle", q.unit, q.mean), constant("rms", q.unit, q.rms), constant("gain", "", axis.gain),
                ],
                starts=[(0.0, 0.0, q.mean, q.rms, axis.gain)], notes={"variant": axis.name},
                predicts="a residual in proportion to input times position", refuted_by="a gain that is the same at every position",
            )
