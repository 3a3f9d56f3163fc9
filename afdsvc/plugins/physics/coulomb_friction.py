"""Coulomb friction: a force of constant size against the direction of motion."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity


def coulomb(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-F tanh(v / w)``, the rounding ``w`` never narrower than one step can follow."""
    out[0] -= p[0] * math.tanh(z[0] / (p[1] + p[0] * dt))


class CoulombFriction:
    """Dry friction on every axis of motion."""

    name = "coulomb_friction"
    summary = "a force of constant size against the direction of motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis."""
        for axis in machine.axes:
            v = axis.rate.rms
            yield at_force(
                axis, coulomb, [velocity(axis)], physics=self.name, family="friction",
                parameters=[
                    force(axis, "force", 0.0, 20 * axis.push, 0.1 * axis.push, linear=True),
                    Coefficient("rounding", axis.rate.unit, 1e-4 * v, 0.7 * v, 0.02 * v, nuisance=True),
                ],
                starts=[(0.0, 0.02 * v), (0.0, 0.2 * v)],
                predicts="a jump of the force where the velocity changes sign; its share falls as the amplitude grows",
                refuted_by="a residual that does not depend on the sign of the velocity",
            )
