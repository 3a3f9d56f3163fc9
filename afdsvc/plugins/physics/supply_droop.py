"""Supply droop: an actuator loses gain while much is asked of it, and recovers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import MOST_TERMS, at_input, at_machine, constant


def droop(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``u (1 - c s / r)`` of every input, never below nothing; ``s`` is the mean of their ``|u|``, summed, over the time constant ``p[1]``."""
    demand = 0.0
    for k in range(len(z)):
        demand += abs(z[k])
    m[0] += (demand - m[0]) * (1 - math.exp(-dt / p[1]))
    for k in range(len(z)):
        out[k] -= z[k] * min(p[0] * m[0] / p[2], 1.0)


class SupplyDroop:
    """A gain that falls with the mean size of every input, and of all inputs of one unit with that of their sum: they share a supply."""

    name = "supply_droop"
    summary = "an actuator gain that falls while the mean demand is high"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, and one for several that share a supply, with means from the excited band to the whole recording."""
        fast, slow = 1 / machine.bandwidth, max(machine.duration, 10 / machine.bandwidth)
        for port in machine.inputs:
            yield at_input(port, droop, **self._words(port.unit, port.rms, fast, slow))
        for unit in dict.fromkeys(u.unit for u in machine.inputs):
            fed = [u for u in machine.inputs if u.unit == unit]
            if 1 < len(fed) <= MOST_TERMS:
                ports = [Signal("u", u.index) for u in fed]
                yield at_machine("input", droop, ports, ports, notes={"variant": ",".join(u.name for u in fed)}, **self._words(unit, sum(u.rms for u in fed), fast, slow))

    def _words(self, unit: str, size: float, fast: float, slow: float) -> dict[str, Any]:
        return {
            "physics": self.name, "family": "relaxation", "memory": 1, "unsettled": 1,
            "parameters": [
                Coefficient("loss at the mean", "", 0.0, 3.0, 0.02, linear=True), Coefficient("time constant", "s", 0.3 * fast, slow, 0.1 * fast),
                constant("mean", unit, size),
            ],
            "starts": [(0.0, fast ** (1 - s) * slow**s, size) for s in (0.1, 0.4, 0.7)],
            "predicts": "a gain that falls some time after a strong passage begins and returns after it",
            "refuted_by": "a gain that depends on the level at once, or not at all",
        }
