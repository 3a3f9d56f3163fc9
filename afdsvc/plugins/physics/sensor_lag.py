"""Sensor lag: the reading passes a first-order low-pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_output


def lagged(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``w``, or where there is a ``p[1]`` what a high-pass reads, ``y - w``: ``tau w' + w = y``, exact for an output that is straight between samples."""
    if m[2] == 0.0:
        m[0], m[1], m[2] = m[0] + z[0], z[0], 1.0
    a = math.exp(-dt / p[0])
    share = p[0] / dt * (1 - a)
    m[0] = a * m[0] + (share - a) * m[1] + (1 - share) * z[0]
    m[1] = z[0]
    out[0] -= m[0] if len(p) > 1 else z[0] - m[0]


def with_sensor_lag(plant: StateSpace, values: Sequence[float], row: int, high: bool = False) -> StateSpace:
    """Return the plant with a lag of ``values[0]`` at an output, or with a high-pass."""
    n = plant.order
    pole = 1 / values[0]
    A = np.block([[plant.A, np.zeros((n, 1))], [pole * plant.C[[row]], np.array([[-pole]])]])
    B = np.vstack([plant.B, pole * plant.D[[row]]])
    C, D = np.hstack([plant.C, np.zeros((plant.outputs, 1))]), plant.D.copy()
    if high:
        C[row, n] = -1.0
    else:
        C[row, :n], C[row, n], D[row] = 0.0, 1.0, 0.0
    return StateSpace(A, B, C, D)


class SensorLag:
    """A slow sensor at every output."""

    name = "sensor_lag"
    summary = "a first-order low-pass between the motion and the reading"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        span = 1 / machine.bandwidth
        for port in machine.outputs:
            yield at_output(
                port, lagged, physics=self.name, family="timing", memory=3, unsettled=1,
                parameters=[Coefficient("time constant", "s", 1e-3 * span, 300 * span, 0.05 * span)],
                starts=[(0.1 * span,), (span,), (10 * span,)],
                linear=lambda plant, values, row=port.index: with_sensor_lag(plant, values, row),
                predicts="phase lag and loss of gain towards high frequency in this output, whatever drives it",
                refuted_by="the same lag in every output from one input (then it is the actuator)",
            )
