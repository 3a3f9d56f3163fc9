"""Viscous damping: a force in proportion to the speed where the model has none, such as bearings, oil or air."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, beside, force, proportional, velocity


class ViscousDamping:
    """A damper on every axis on which the model has none."""

    name = "viscous_damping"
    summary = "a friction in proportion to the speed, where the model has none"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis whose force does not depend on its velocity."""
        for axis in machine.axes:
            if (add := beside(machine, axis, axis.rate)) is not None:
                scale = 0.05 * axis.push / axis.rate.rms
                words: dict[str, Any] = {"predicts": "a linear residual that follows the velocity", "refuted_by": "a motion that goes on when nothing drives it"}
                yield at_force(
                    axis, proportional, [velocity(axis)], physics=self.name, family="damping", starts=[(0.0,)], linear=add, **words,
                    parameters=[force(axis, "damping", -200 * scale, 200 * scale, scale, axis.rate.unit, linear=True)],
                )
