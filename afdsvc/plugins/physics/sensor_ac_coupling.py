"""AC coupling: a reading that loses what is slow, behind a capacitor or in a charge amplifier."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_output


def _coupled(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y - s``, ``tau s' + s = y``, exact for an output that is straight between samples; the capacitor begins at rest with y."""
    if m[2] == 0.0:
        m[0], m[1], m[2] = m[0] + z[0], z[0], 1.0
    a = math.exp(-dt / p[0])
    share = p[0] / dt * (1 - a)
    m[0] = a * m[0] + (share - a) * m[1] + (1 - share) * z[0]
    m[1] = z[0]
    out[0] -= m[0]


def _extend(plant: StateSpace, values: Sequence[float], row: int) -> StateSpace:
    n, pole = plant.order, 1 / values[0]
    A = np.block([[plant.A, np.zeros((n, 1))], [pole * plant.C[[row]], np.array([[-pole]])]])
    B = np.vstack([plant.B, pole * plant.D[[row]]])
    C = np.hstack([plant.C, np.zeros((plant.outputs, 1))])
    C[row, n] = -1.0
    return StateSpace(A, B, C, plant.D)


class SensorAcCoupling:
    """A high-pass of first order at every output, from the slowest that the recordings show to the fastest that is excited."""

    name = "sensor_ac_coupling"
    summary = "a first-order high-pass between the motion and the reading: AC coupling, a charge amplifier"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        fast, slow = 0.1 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth)
        for port in machine.outputs:
            yield at_output(
                port, _coupled, physics=self.name, family="timing", memory=3, unsettled=1,
                parameters=[Coefficient("time constant", "s", fast, slow, 0.1 * fast)],
                starts=[(fast ** (1 - s) * slow**s,) for s in (0.25, 0.5, 0.75)],
                linear=lambda plant, values, row=port.index: _extend(plant, values, row),
                predicts="phase lead and loss of gain towards low frequency in this output, whatever drives it", refuted_by="a reading that holds a constant value",
            )
