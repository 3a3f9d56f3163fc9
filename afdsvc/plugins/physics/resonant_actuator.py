"""Resonant actuator: the input reaches the machine through a second-order low-pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_input


def resonant(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``v'' + 2 zeta w v' + w^2 v = w^2 u``, exact for a held input; the mean of v over the step replaces u."""
    w, zeta = p[0], p[1]
    decay, wd = math.exp(-zeta * w * dt), w * math.sqrt(max(1 - zeta * zeta, 1e-12))
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    e, v = m[0] - z[0], m[1]
    e1 = decay * (e * c + (v + zeta * w * e) / wd * s)
    v1 = decay * (v * c - (w * w * e + zeta * w * v) / wd * s)
    m[0], m[1] = z[0] + e1, v1
    out[0] -= ((v1 - v) + 2 * zeta * w * (e1 - e)) / (w * w * dt)


def _extend(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    w, zeta = values[0], values[1]
    n, m = plant.order, plant.inputs
    A = np.zeros((n + 2, n + 2))
    A[:n, :n], A[:n, n] = plant.A, plant.B[:, column]
    A[n, n + 1], A[n + 1, n], A[n + 1, n + 1] = 1.0, -w * w, -2 * zeta * w
    B = np.vstack([plant.B, np.zeros((2, m))])
    B[:n, column], B[n + 1, column] = 0.0, w * w
    D = plant.D.copy()
    D[:, column] = 0.0
    return StateSpace(A, B, np.hstack([plant.C, plant.D[:, [column]], np.zeros((plant.outputs, 1))]), D)


class ResonantActuator:
    """A second-order actuator at every input."""

    name = "resonant_actuator"
    summary = "a second-order low-pass between the command and what the actuator does"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, with the resonance inside and above the excited band."""
        top = machine.bandwidth
        for port in machine.inputs:
            yield at_input(
                port, resonant, physics=self.name, family="timing", memory=2, unsettled=1, substeps=4,
                parameters=[
                    Coefficient("frequency", "rad/s", 0.05 * top, min(30 * top, 2.5 / machine.dt), 0.02 * top),
                    Coefficient("damping ratio", "", 0.01, 0.98, 0.05),
                ],
                starts=[(f * top, zeta) for f in (0.5, 1.2, 3.0) for zeta in (0.1, 0.6) if f * top < 2.4 / machine.dt],
                linear=lambda plant, values, column=port.index: _extend(plant, values, column),
                predicts="a rise of gain and a fall of phase at the top of the band, for this input only",
                refuted_by="a gain that falls from the lowest frequencies on",
            )
