"""Gravity on a part that turns: a force that goes with the sine of the angle."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Axis, Hypothesis, Machine, Size
from afdsvc.plugins.physics.attach import at_force, constant, force, placed, quantity, radians, state


def _weight(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-a sin(q) - b cos(q)``: the vertical need not be where the angle is zero; ``p[2]`` is a radian per unit of q."""
    out[0] -= p[0] * math.sin(p[2] * z[0]) + p[1] * math.cos(p[2] * z[0])


def _in_place(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-(a sin(q) + b q)``: what the model has as a straight line, of the right slope or of one fitted to a large swing, is a sine."""
    angle = p[2] * z[0]
    out[0] -= p[0] * math.sin(angle) + p[1] * angle


class Gravity:
    """Weight on every axis that turns, missing or there as a straight line."""

    name = "gravity"
    summary = "a weight that turns: a force that goes with the sine of the angle"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per axis whose position is an angle."""
        for axis, q in placed(machine):
            if quantity(q.unit) == "angle":
                yield self._on(axis, q, _weight, "cosine", {})
                yield self._on(axis, q, _in_place, "line", {"variant": "sine in place of a line", "of": ""})

    def _on(self, axis: Axis, q: Size, law: Any, beside: str, notes: dict[str, str]) -> Hypothesis:
        push, radian = axis.push, radians(q.unit)
        most = 100 * push * max(1.0, 1 / (radian * q.rms))
        return at_force(
            axis, law, [state(q)], physics=self.name, family="stiffness", starts=[(0.0, 0.0, radian)], notes=notes,
            parameters=[
                *(force(axis, f"{part} force", -most, most, 0.1 * push, linear=True) for part in ("sine", beside)),
                constant("radian", f"rad/{q.unit}", radian),
            ],
            predicts="a stiffness that falls with the angle from hanging and changes sign at a quarter turn",
            refuted_by="a stiffness that is the same at every angle",
        )
