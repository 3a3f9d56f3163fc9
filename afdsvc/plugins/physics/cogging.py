"""Cogging: a force that repeats along the way, from poles, teeth or balls."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal, Size
from afdsvc.plugins.physics.attach import (
    at_force,
    force,
    least_wave,
    orders,
    placed,
    quantity,
    radians,
    radians_per_second,
    state,
    turn_periods,
    velocity,
)

WORDS = {"predicts": "a force of the same period along the way at every speed", "refuted_by": "a frequency that does not follow the speed"}
ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 36, 48)  # periods per turn that a search begins from


def _ripple(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a cos(k q) + b sin(k q)``."""
    out[0] += p[1] * math.cos(p[0] * z[0]) + p[2] * math.sin(p[0] * z[0])


def _turning(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``p[2] m[0]`` in the middle of the step; ``m`` turns ``p[0]`` times as far as the shaft, of whose speed one unit is ``p[1]`` rad/s."""
    half = 0.5 * p[0] * p[1] * z[0] * dt
    c, s = math.cos(half), math.sin(half)
    for turn in range(2):
        m[0], m[1] = c * m[0] - s * m[1], s * m[0] + c * m[1]
        if turn == 0:
            out[0] += p[2] * m[0]


class Cogging:
    """A periodic force along every axis whose position is a state, or whose angle is recorded, or that turns with a known speed."""

    name = "cogging"
    summary = "a force that repeats along the way"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per axis, with periods from the way travelled to a tenth of it, or whole ones per turn, and with those that the residual shows.

        A wave of which no two periods were travelled is not offered.
        """
        for axis, q in placed(machine):
            yield from self._on(axis, state(q), q, quantity(q.unit) == "angle", machine.waves.get(state(q), ()))
        angle = machine.aux.get("angle")
        for axis in machine.axes:
            if axis.position is None and angle:
                yield from self._on(axis, Signal("aux", angle.index), angle, True)
            elif axis.position is None:
                yield from self._turning(axis, machine)

    def _turning(self, axis: Axis, machine: Machine) -> Iterable[Hypothesis]:
        unit, speed = radians_per_second(axis.rate.unit), max(axis.rate.rms, abs(axis.rate.mean))
        if unit and (starts := orders(unit * speed, machine.dt)):
            size = axis.push / speed
            yield at_force(
                axis, _turning, [velocity(axis)], memory=2, unsettled=2, lasting=True, substeps=4, physics=self.name, family="ripple",
                parameters=[*turn_periods(unit), force(axis, "amplitude", size, size, size)], starts=[(n, unit, size) for n in starts], **WORDS,
            )

    def _on(self, axis: Axis, where: Signal, way: Size, turns: bool, waves: Sequence[float] = ()) -> Iterable[Hypothesis]:
        least, unit = least_wave(way), way.unit if where.kind == "x" else "rad"
        if math.isinf(least):
            return
        numbers = [n * radians(unit) for n in ORDERS if n * radians(unit) >= least] if turns else least * np.geomspace(1.0, 10, 9)
        if not len(numbers):
            return
        numbers, scale = [*numbers, *(k for k in waves if k >= least)], 0.05 * axis.push
        pair = [force(axis, f"{part} force", -1e3 * scale, 1e3 * scale, scale, linear=True) for part in ("cosine", "sine")]
        yield at_force(
            axis, _ripple, [where], physics=self.name, family="ripple",
            parameters=[Coefficient("wave number", f"rad/{unit}", max(least, 0.2 * min(numbers)), 5 * max(numbers), 0.01 * least), *pair],
            starts=[(float(k), 0.0, 0.0) for k in numbers],
            **WORDS,
        )
