"""Stribeck friction: more force at very low speed than at higher speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity


def stribeck(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-(Fc + Fb exp(-(v / vs)^2)) tanh(v / w)``: Fc at speed, Fc + Fb at standstill."""
    size = p[0] + p[1] * math.exp(-((z[0] / p[2]) ** 2))
    out[0] -= size * math.tanh(z[0] / (p[3] + size * dt))


class StribeckFriction:
    """Dry friction with a breakaway force on every axis of motion."""

    name = "stribeck_friction"
    summary = "dry friction that falls from a breakaway force as the speed rises"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis."""
        for axis in machine.axes:
            v, push = axis.rate.rms, axis.push
            yield at_force(
                axis, stribeck, [velocity(axis)], physics=self.name, family="friction",
                parameters=[
                    force(axis, "force", 0.0, 20 * push, 0.1 * push, linear=True),
                    force(axis, "breakaway excess", 0.0, 20 * push, 0.1 * push, linear=True),
                    Coefficient("stribeck speed", axis.rate.unit, 1e-2 * v, 3 * v, 0.1 * v),
                    Coefficient("rounding", axis.rate.unit, 1e-4 * v, 0.3 * v, 0.02 * v, nuisance=True),
                ],
                starts=[(0.0, 0.0, 0.1 * v, 0.01 * v), (0.0, 0.0, 0.4 * v, 0.02 * v), (0.0, 0.0, 1.0 * v, 0.1 * v)],
                predicts="a force that is largest just after the velocity changes sign and falls with speed",
                refuted_by="a friction force that stays the same from creeping to full speed",
            )
