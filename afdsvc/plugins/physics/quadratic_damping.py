"""Quadratic damping: drag that grows with the square of the speed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity


def drag(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c v |v|``."""
    out[0] -= p[0] * z[0] * abs(z[0])


class QuadraticDamping:
    """Turbulent drag on every axis of motion."""

    name = "quadratic_damping"
    summary = "drag that grows with the square of the speed"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis."""
        for axis in machine.axes:
            scale = 0.1 * axis.push / axis.rate.rms**2
            yield at_force(
                axis, drag, [velocity(axis)], physics=self.name, family="damping",
                parameters=[
                    force(axis, "drag", 0.0, 200 * scale, scale, f"({axis.rate.unit})^2", linear=True)
                ],
                starts=[(0.0,)],
                predicts="damping that grows with the amplitude; odd distortion in phase with the velocity",
                refuted_by="damping that is the same at every level",
            )
