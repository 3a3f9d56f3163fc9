"""Actuator lag: the input reaches the machine through a first-order low-pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_input


def _lag(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``tau v' + v = u``: the mean of v over the step replaces u."""
    decay = math.exp(-dt / p[0])
    rest = m[0] - z[0]
    out[0] += rest * (1 - decay) * p[0] / dt
    m[0] = z[0] + rest * decay


def _extend(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    n, m = plant.order, plant.inputs
    pole = 1 / values[0]
    A = np.block([[plant.A, plant.B[:, [column]]], [np.zeros((1, n)), np.array([[-pole]])]])
    B = np.vstack([plant.B, np.zeros((1, m))])
    B[:n, column] = 0.0
    B[n, column] = pole
    D = plant.D.copy()
    D[:, column] = 0.0
    return StateSpace(A, B, np.hstack([plant.C, plant.D[:, [column]]]), D)


class ActuatorLag:
    """An actuator slower than the model says, at every input."""

    name = "actuator_lag"
    summary = "a first-order low-pass between the command and what the actuator does"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input."""
        span = 1 / machine.bandwidth
        for port in machine.inputs:
            yield at_input(
                port, _lag, physics=self.name, family="timing", memory=1, unsettled=1, substeps=4,
                parameters=[Coefficient("time constant", "s", 1e-3 * span, 300 * span, 0.05 * span)],
                starts=[(0.1 * span,), (span,), (10 * span,)],
                linear=lambda plant, values, column=port.index: _extend(plant, values, column),
                predicts="phase lag that saturates and gain that falls with frequency, for this input only",
                refuted_by="a gain that stays the same where the phase falls",
            )
