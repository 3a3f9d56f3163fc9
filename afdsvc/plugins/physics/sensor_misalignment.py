"""Sensor misalignment: two sensors turned against the axes they should read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_machine


def turned(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The pair of readings turned by an angle."""
    c, s = math.cos(p[0]), math.sin(p[0])
    out[0] += (c - 1) * z[0] - s * z[1]
    out[1] += s * z[0] + (c - 1) * z[1]


def _turn(plant: StateSpace, values: Sequence[float], i: int, j: int) -> StateSpace:
    T = np.eye(plant.outputs)
    c, s = math.cos(values[0]), math.sin(values[0])
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return StateSpace(plant.A, plant.B, T @ plant.C, T @ plant.D, plant.dt)


class SensorMisalignment:
    """A pair of sensors turned together, for every pair of outputs with the same unit."""

    name = "sensor_misalignment"
    summary = "two sensors turned together by an angle"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per pair of outputs."""
        for a, b in combinations(machine.outputs, 2):
            if a.unit != b.unit:
                continue
            pair = [Signal("y", a.index), Signal("y", b.index)]
            yield at_machine(
                "output", turned, pair, pair, physics=self.name, family="coupling",
                parameters=[Coefficient("angle", "rad", -1.5, 1.5, 0.01)], starts=[(0.02,), (-0.02,), (0.2,), (-0.2,)],
                linear=lambda plant, values, i=a.index, j=b.index: _turn(plant, values, i, j),
                notes={"variant": f"{a.name},{b.name}"},
                predicts="each reading holds a share of the other with opposite signs, the same at every frequency and level",
                refuted_by="a cross-talk in one direction only, or one that depends on frequency",
            )
