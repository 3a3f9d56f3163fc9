"""Slew limit: the actuator cannot follow faster than a rate."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input


def slew(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``m`` follows the input, changing by at most ``rate dt`` per step."""
    if m[1] == 0.0:
        m[0], m[1] = z[0], 1.0
    m[0] += min(max(z[0] - m[0], -p[0] * dt), p[0] * dt)
    out[0] += m[0] - z[0]


class SlewLimit:
    """A rate limit at every input."""

    name = "slew_limit"
    summary = "an input that can change no faster than a rate"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, with rates from a tenth of the excitation's to three times it."""
        for port in machine.inputs:
            rate = port.rms * machine.bandwidth
            yield at_input(
                port, slew, physics=self.name, family="memory", memory=2,
                parameters=[Coefficient("rate", f"{port.unit}/s", 1e-3 * rate, 6 * rate, 0.02 * rate)],
                starts=[(0.1 * rate,), (0.4 * rate,), (1.0 * rate,), (2.2 * rate,), (3.5 * rate,)],
                predicts="lag and lost amplitude at high frequency and high level only",
                refuted_by="the same lag at every level",
            )
