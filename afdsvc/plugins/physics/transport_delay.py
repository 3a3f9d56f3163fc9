"""Transport delay: what is commanded, or measured, arrives later."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_output

LONGEST = 400  # samples that are remembered
STARTS = (0.5, 1.5, 5.0, 12.0, 30.0, 75.0, 180.0)  # samples


def delay(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The value ``tau`` ago, interpolated between samples; ``m`` is a ring (first a count) of the last samples."""
    size = len(m) - 1
    if m[0] == 0.0:
        for i in range(size):
            m[1 + i] = z[0]
    k = int(m[0])
    m[1 + k % size] = z[0]
    m[0] = k + 1.0
    lag = min(p[0] / dt, size - 2.0)
    whole = int(math.floor(lag))
    part = lag - whole
    now, before = m[1 + (k - whole) % size], m[1 + (k - whole - 1) % size]
    out[0] += (1 - part) * now + part * before - z[0]


class TransportDelay:
    """A pure delay at every input and every output."""

    name = "transport_delay"
    summary = "a pure delay between command and action, or between motion and reading"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input and per output."""
        longest = max(8 * machine.dt, min(LONGEST * machine.dt, machine.duration / 20))
        parts: dict[str, Any] = {
            "physics": self.name, "family": "timing",
            "parameters": [Coefficient("delay", "s", 0.01 * machine.dt, longest, 0.2 * machine.dt)],
            "starts": [(k * machine.dt,) for k in STARTS if k * machine.dt < longest],
            "predicts": "phase lag proportional to frequency at an unchanged gain",
            "refuted_by": "a gain that changes with the phase, or a phase lag that levels off",
        }
        for port in machine.inputs:
            yield at_input(port, delay, memory=int(4 * longest / machine.dt) + 4, substeps=4, **parts)
        for port in machine.outputs:
            yield at_output(port, delay, memory=int(longest / machine.dt) + 4, **parts)
