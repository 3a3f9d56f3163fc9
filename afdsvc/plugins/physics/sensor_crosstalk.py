"""Sensor cross-talk: a reading that holds a share of another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import permutations
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_output


def _share(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y + c y_other``."""
    out[0] += p[0] * z[1]


def _mix(plant: StateSpace, values: Sequence[float], i: int, j: int) -> StateSpace:
    T = np.eye(plant.outputs)
    T[i, j] = values[0]
    return StateSpace(plant.A, plant.B, T @ plant.C, T @ plant.D, plant.dt)


class SensorCrosstalk:
    """A share of one reading in another, for every ordered pair of outputs."""

    name = "sensor_crosstalk"
    summary = "a reading that holds a share of another reading"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per ordered pair of outputs."""
        for a, b in permutations(machine.outputs, 2):
            ratio = a.rms / b.rms
            yield at_output(
                a, _share, [Signal("y", b.index)], physics=self.name, family="coupling",
                parameters=[Coefficient(f"share of {b.name}", f"{a.unit}/{b.unit}" if a.unit != b.unit else "", -10 * ratio, 10 * ratio, 0.02 * ratio, linear=True)],
                starts=[(0.0,)], linear=lambda plant, values, i=a.index, j=b.index: _mix(plant, values, i, j),
                notes={"variant": b.name},
                predicts="this reading follows the other at every frequency; the other is unchanged",
                refuted_by="both readings holding a share of each other, or a share that depends on frequency",
            )
