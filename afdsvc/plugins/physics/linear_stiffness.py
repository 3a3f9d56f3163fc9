"""Linear stiffness: a spring where the model has none, such as a cable, a hose or a seal that holds the axis."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_missing, placed


class LinearStiffness:
    """A spring on every axis on which the model has none."""

    name = "linear_stiffness"
    summary = "a spring force in proportion to the deflection, where the model has none"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis with a position that its force does not depend on."""
        for axis, q in placed(machine):
            yield from at_missing(
                machine, axis, q, "stiffness", physics=self.name, family="stiffness",
                predicts="a linear residual that follows the position", refuted_by="a position that stays where it is left",
            )
