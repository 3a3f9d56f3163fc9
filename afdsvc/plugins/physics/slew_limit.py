"""Slew limit: the actuator cannot follow faster than a rate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_state, input_followers


def _slew(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``m`` follows the input, rising by at most ``p[0] dt`` per step and falling by at most ``p[1] dt``; its mean over the step."""
    if m[1] == 0.0:
        m[0], m[1] = m[0] + z[0], 1.0
    way = z[0] - m[0]
    reach = (p[0] if way > 0 else p[1]) * dt
    share = min(abs(way) / reach, 1.0)  # of the step under way
    moved = math.copysign(reach * share, way)
    out[0] += m[0] + moved * (1 - 0.5 * share) - z[0]
    m[0] += moved


def rate_limited(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The rate of change of a state, ``p[2:] z``, held between ``-p[1]`` and ``p[0]``."""
    rate = 0.0
    for k in range(len(z)):
        rate += p[2 + k] * z[k]
    out[0] += min(max(rate, -p[1]), p[0]) - rate


class SlewLimit:
    """A rate limit at every input, upwards and downwards, and of every state that does nothing but follow an input."""

    name = "slew_limit"
    summary = "an input that can change no faster than a rate"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, with rates from a tenth of the excitation's up to those that no step of it reaches but
        that take a part of the step, and one per state that follows an input."""
        words: dict[str, Any] = {
            "physics": self.name, "family": "rate", "predicts": "lag and lost amplitude at high frequency and high level only", "refuted_by": "the same lag at every level",
        }
        for port in machine.inputs:
            rate, jump = port.rms * machine.bandwidth, port.rms / machine.dt
            yield at_input(
                port, _slew, memory=2, unsettled=1, **words,
                parameters=[
                    Coefficient(name, f"{port.unit}/s", 1e-3 * rate, max(6 * rate, 20 * jump), 0.02 * rate) for name in ("rate", "falling rate")
                ],
                starts=[(s, s) for s in (0.1 * rate, 0.4 * rate, 1.0 * rate, 2.2 * rate, 3.5 * rate, 5 * jump)],
            )
        for x, reads, constants in input_followers(machine):
            rate = x.rms * machine.bandwidth
            yield at_state(
                x, rate_limited, reads, **words,
                parameters=[*(Coefficient(name, f"{x.unit}/s", 1e-3 * rate, 20 * rate, 0.02 * rate) for name in ("rate", "falling rate")), *constants],
                starts=[(s * rate, s * rate, *(c.low for c in constants)) for s in (0.1, 0.3, 0.8, 1.5)],
            )
