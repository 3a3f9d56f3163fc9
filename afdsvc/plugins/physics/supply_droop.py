"""Supply droop: an actuator loses gain while much is asked of it, and recovers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, constant


def droop(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``u (1 - c s / r)``, never below nothing; ``s`` is the mean of ``|u|`` over the time constant ``p[1]``."""
    m[0] += (abs(z[0]) - m[0]) * (1 - math.exp(-dt / p[1]))
    out[0] -= z[0] * min(p[0] * m[0] / p[2], 1.0)


class SupplyDroop:
    """A gain that falls with the mean size of every input."""

    name = "supply_droop"
    summary = "an actuator gain that falls while the mean demand is high"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, with means from the excited band to the whole recording."""
        fast, slow = 1 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth)
        for port in machine.inputs:
            yield at_input(
                port, droop, physics=self.name, family="relaxation", memory=1, unsettled=1,
                parameters=[
                    Coefficient("loss at the mean", "", 0.0, 3.0, 0.02, linear=True), Coefficient("time constant", "s", 0.3 * fast, slow, 0.1 * fast),
                    constant("mean", port.unit, port.rms),
                ],
                starts=[(0.0, fast ** (1 - s) * slow**s, port.rms) for s in (0.1, 0.4, 0.7)],
                predicts="a gain that falls some time after a strong passage begins and returns after it",
                refuted_by="a gain that depends on the level at once, or not at all",
            )
