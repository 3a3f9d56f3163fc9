"""Repulsion: a force that grows towards one end of the way, such as ground effect, the force of a magnet, an air cushion or fringe fields."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Size
from afdsvc.plugins.physics.attach import at_force, constant, force, placed, quantity, state


def _growing(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-s a exp(s (q - q0) / l)``: away from the end on side s; ``p = (a, l, q0, s)``, a negative where it attracts."""
    out[0] -= p[3] * p[0] * math.exp(min(p[3] * (z[0] - p[2]) / p[1], 50.0))  # bounded: no trial overflows


class Repulsion:
    """A force that decays exponentially with the distance from one end of the way, on every axis with a position along a line."""

    name = "repulsion"
    summary = "a force that grows towards one end of the way"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per end of every axis whose position is not an angle."""
        for axis, q in placed(machine):
            if quantity(q.unit) != "angle":
                for side, word in ((1.0, "above"), (-1.0, "below")):
                    yield self._from(axis, q, side, word)

    def _from(self, axis: Axis, q: Size, side: float, word: str) -> Hypothesis:
        place, most = q.mean + side * q.rms, 100 * axis.push
        return at_force(
            axis, _growing, [state(q)], physics=self.name, family="stiffness", notes={"variant": f"from {word}", "of": ""},
            parameters=[
                force(axis, "force at the rms", -most, most, 0.1 * axis.push, linear=True),
                Coefficient("length", q.unit, 0.03 * q.reach, q.reach / 3, 0.03 * q.reach),  # longer ones are springs
                constant("place", q.unit, place), constant("side", "", side),
            ],
            starts=[(0.0, share * q.reach, place, side) for share in (0.1, 0.25)],
            predicts=f"a stiffness that grows towards what is {word} and is small on the other side", refuted_by="a stiffness that is the same along the way",
        )
