"""Cubic damping: drag that grows with the cube of the speed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, velocity


def _cubic(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c v^3``."""
    out[0] -= p[0] * z[0] ** 3


class CubicDamping:
    """A damper that stiffens, on every axis of motion."""

    name = "cubic_damping"
    summary = "damping that grows with the square of the amplitude"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis."""
        for axis in machine.axes:
            scale = 0.1 * axis.push / axis.rate.rms**3
            yield at_force(
                axis, _cubic, [velocity(axis)], physics=self.name, family="damping",
                parameters=[
                    force(axis, "coefficient", 0.0, 200 * scale, scale, f"({axis.rate.unit})^3", linear=True)
                ],
                starts=[(0.0,)], description=True,
                predicts="damping that grows with the square of the amplitude; odd distortion in phase with the velocity",
                refuted_by="damping that is the same at every level",
            )
