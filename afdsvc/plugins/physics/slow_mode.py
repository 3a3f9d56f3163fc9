"""Slow mode: a second store of heat, fluid or charge that exchanges with the one the model has."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_state, decaying, state


def relaxing(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-c (x - s)`` with ``tau s' = x - s``: the mean over a step of held x; the store begins at rest with x."""
    if m[1] == 0.0:
        m[0], m[1] = m[0] + z[0], 1.0
    decay, rest = math.exp(-dt / p[1]), m[0] - z[0]
    out[0] += p[0] * rest * (1 - decay) * p[1] / dt
    m[0] = z[0] + rest * decay


def with_store(plant: StateSpace, values: Sequence[float], i: int, j: int) -> StateSpace:
    """Return the plant with ``-c (x_j - s)`` added to the rate of state i, ``values`` c and tau."""
    n, (rate, tau) = plant.order, values[:2]
    A = np.zeros((n + 1, n + 1))
    A[:n, :n] = plant.A
    A[i, j] -= rate
    A[i, n], A[n, j], A[n, n] = rate, 1 / tau, -1 / tau
    return StateSpace(A, np.vstack([plant.B, np.zeros((1, plant.inputs))]), np.hstack([plant.C, np.zeros((plant.outputs, 1))]), plant.D)


class SlowMode:
    """A second store beside every state that belongs to no axis and decays by itself: heat, fluid, or the current of a coil beside eddy currents."""

    name = "slow_mode"
    summary = "a second store that takes up and gives back slowly"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per store, from as fast as the excitation to as slow as the recordings."""
        for store, own in decaying(machine):
            fast, slow = 0.3 / machine.bandwidth, max(3 * machine.duration, 30 / machine.bandwidth)
            most = max(50 * own, machine.bandwidth)
            yield at_state(
                store, relaxing, [state(store)], physics=self.name, family="relaxation", memory=2, unsettled=1,
                parameters=[
                    Coefficient("exchange rate", "1/s", 0.0, most, 0.05 * own, linear=True),
                    Coefficient("time constant", "s", fast, slow, 0.1 * fast),
                ],
                starts=[(0.0, fast ** (1 - s) * slow**s) for s in (0.2, 0.4, 0.6, 0.8)],
                linear=lambda plant, values, i=store.index: with_store(plant, values, i, i),
                predicts="a fast answer followed by a slow one to the same end value", refuted_by="an answer with one time constant",
            )
