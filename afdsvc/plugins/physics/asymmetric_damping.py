"""Asymmetric damping: another damping in each direction, as in a shock absorber."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity


def _damper(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c1 v`` forwards and ``-c2 v`` backwards."""
    out[0] -= (p[0] if z[0] > 0 else p[1]) * z[0]


class AsymmetricDamping:
    """A damper with two coefficients on every axis of motion, beside the model's own damping."""

    name = "asymmetric_damping"
    summary = "damping that differs between the two directions of motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis that moves both ways; each direction may lose what damping the model has, and no more."""
        for axis in [a for a in machine.axes if a.rate.reverses]:
            i, scale = axis.rate.index, 0.1 * axis.push / axis.rate.rms
            own = 0.0 if machine.plant is None else max(-float(machine.plant.A[i, i]), 0.0)
            yield at_force(
                axis, _damper, [velocity(axis)], physics=self.name, family="damping", starts=[(0.0, 0.0)],
                parameters=[
                    force(axis, f"damping {way}", -own, max(200 * scale, own), scale, axis.rate.unit, linear=True) for way in ("forwards", "backwards")
                ],
                predicts="even distortion in proportion to the level, and a mean that shifts with the speed",
                refuted_by="a residual that is the same in both directions of motion",
            )
