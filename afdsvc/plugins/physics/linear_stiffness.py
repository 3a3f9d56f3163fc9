"""Linear stiffness: a spring where the model has none, such as a cable, a hose or a seal that holds the axis."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, beside, force, placed, proportional, state


class LinearStiffness:
    """A spring on every axis on which the model has none."""

    name = "linear_stiffness"
    summary = "a spring force in proportion to the deflection, where the model has none"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis with a position that its force does not depend on."""
        for axis, q in placed(machine):
            if (add := beside(machine, axis, q)) is not None:
                scale = 0.05 * axis.push / q.rms
                words: dict[str, Any] = {"predicts": "a linear residual that follows the position", "refuted_by": "a position that stays where it is left"}
                yield at_force(
                    axis, proportional, [state(q)], physics=self.name, family="stiffness", starts=[(0.0,)], linear=add, **words,
                    parameters=[force(axis, "stiffness", -200 * scale, 200 * scale, scale, q.unit, linear=True)],
                )
