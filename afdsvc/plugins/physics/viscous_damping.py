"""Viscous damping: a force in proportion to the speed where the model has none, such as bearings, oil or air."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_missing


class ViscousDamping:
    """A damper on every axis on which the model has none."""

    name = "viscous_damping"
    summary = "a friction in proportion to the speed, where the model has none"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis whose force does not depend on its velocity."""
        for axis in machine.axes:
            yield from at_missing(
                machine, axis, axis.rate, "damping", physics=self.name, family="damping",
                predicts="a linear residual that follows the velocity", refuted_by="a motion that goes on when nothing drives it",
            )
