"""Clearance: a stop, or a second spring, that is met only beyond a gap."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_force, force, placed, state


def stop(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k (|q| - g)`` towards the middle once ``|q| > g``."""
    over = abs(z[0]) - p[1]
    if over > 0:
        out[0] -= p[0] * math.copysign(over, z[0])


class Clearance:
    """A spring behind a gap on every axis of motion."""

    name = "clearance"
    summary = "a spring force that begins only beyond a gap"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis, started at gaps between a third and nearly all of the travel."""
        for axis, q in placed(machine):
            peak = q.peak
            scale = 0.1 * axis.push / q.rms
            yield at_force(
                axis, stop, [state(q)], physics=self.name, family="stiffness",
                parameters=[
                    force(axis, "stiffness", 0.0, 1e4 * scale, scale, q.unit, linear=True),
                    Coefficient("gap", q.unit, 0.02 * peak, 0.98 * peak, 0.02 * peak),
                ],
                starts=[(0.0, share * peak) for share in (0.15, 0.35, 0.6, 0.8)],
                predicts="nothing below a level, and above it a stiffness that sets in at the same deflection everywhere",
                refuted_by="distortion at levels that never reach the gap",
            )
