"""Creep: the effect goes on growing slowly after the command has stopped."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input


def _creep(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a`` times the mean of three lags with time constants ``tau, 5 tau, 25 tau``: nearly logarithmic in time."""
    tau = p[1]
    for k in range(3):
        m[k] += (z[0] - m[k]) * (1 - math.exp(-dt / tau))
        out[0] += p[0] * m[k] / 3
        tau *= 5.0


class Creep:
    """Slow growth of the effect at every input."""

    name = "creep"
    summary = "an effect that goes on growing slowly, nearly with the logarithm of time"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, with creep from the slow end of the excited band to the whole recording."""
        fast, slow = 3 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth)
        for port in machine.inputs:
            yield at_input(
                port, _creep, physics=self.name, family="relaxation", memory=3,
                parameters=[
                    Coefficient("share", "", -3.0, 3.0, 0.05, linear=True),
                    Coefficient("time constant", "s", fast, slow, 0.1 * fast),
                ],
                starts=[(0.0, fast ** (1 - s) * slow**s) for s in (0.15, 0.35, 0.6)],
                predicts="a linear residual at the lowest frequencies that falls over decades of frequency",
                refuted_by="a residual at the middle of the band or at unexcited lines",
            )
