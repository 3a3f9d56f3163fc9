"""Velocity coupling: a force on one axis that is quadratic in the velocities, one of them another axis': Coriolis and centrifugal forces, drag in a turn."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import permutations
from typing import Any

from afdsvc.api.physics import Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_force, force, velocity


def squared_speed(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c w^2``, ``w`` the velocity of the other axis."""
    out[0] -= p[0] * z[0] * z[0]


def product_of_speeds(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c v w``, ``v`` the axis' own velocity and ``w`` that of the other."""
    out[0] -= p[0] * z[0] * z[1]


class VelocityCoupling:
    """Every ordered pair of axes: the square of the other's velocity, or the product of both, as in Coriolis and centrifugal forces (Fossen, Guidance
    and Control of Ocean Vehicles, 1994, chapter 2) and the drag of a vehicle in a turn. Every axis and input that does not drive it: the product of
    its velocity with the input, as with a rope that is hoisted while it swings, or a brake."""

    name = "velocity_coupling"
    summary = "a force on one axis that goes with the square of another's velocity, or with the product of its own and another, or an input"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per ordered pair, and one per axis and further input."""
        shared: dict[str, Any] = {
            "physics": self.name, "family": "cross coupling", "starts": [(0.0,)],
            "predicts": "a residual of one axis that grows with the square of the speed of another", "refuted_by": "a residual that is the same whether the other axis moves or stands",
        }
        for a, b in permutations(machine.axes, 2):
            for law, first, word in ((squared_speed, b, "square"), (product_of_speeds, a, "product")):
                unit = f"({b.rate.unit})^2" if law is squared_speed else f"(({a.rate.unit}) ({b.rate.unit}))"
                scale = 0.1 * a.push / (math.hypot(first.rate.rms, first.rate.mean) * math.hypot(b.rate.rms, b.rate.mean))
                yield at_force(
                    a, law, [velocity(b)] if law is squared_speed else [velocity(a), velocity(b)], notes={"variant": f"{word}: {b.rate.name}", "of": b.rate.name},
                    parameters=[force(a, "coupling", -200 * scale, 200 * scale, scale, unit, linear=True)], **shared,
                )
        for a in machine.axes:
            for u in machine.inputs:
                if u.index != a.input:
                    scale = 0.1 * a.push / (math.hypot(a.rate.rms, a.rate.mean) * math.hypot(u.rms, u.mean))
                    yield at_force(
                        a, product_of_speeds, [velocity(a), Signal("u", u.index)], notes={"variant": f"product: {u.name}", "of": u.name},
                        parameters=[force(a, "coupling", -200 * scale, 200 * scale, scale, f"(({a.rate.unit}) ({u.unit}))", linear=True)], **shared,
                    )
