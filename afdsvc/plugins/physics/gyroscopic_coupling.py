"""Gyroscopic coupling: motion of one axis pushes the other, in proportion to the rotor speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_machine, velocity


def _gyroscopic(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-g v2`` on the first axis and ``+g v1`` on the second, times the speed over its reference."""
    share = p[0] * (z[2] / p[1] if len(z) > 2 else 1.0)
    out[0] -= share * z[1]
    out[1] += share * z[0]


class GyroscopicCoupling:
    """A skew-symmetric coupling of velocities, for every pair of axes."""

    name = "gyroscopic_coupling"
    summary = "velocities of two axes coupled with opposite signs, in proportion to the rotor speed"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per pair of axes."""
        aux = machine.aux.get("speed")
        speed = (math.hypot(aux.mean, aux.rms) or 1.0) if aux else 1.0
        for a, b in combinations(machine.axes, 2):
            scale = 0.05 * min(a.push / b.rate.rms, b.push / a.rate.rms)
            reads = [velocity(a), velocity(b), *([Signal("aux", aux.index)] if aux else [])]
            yield at_machine(
                "force", _gyroscopic, reads, [velocity(a), velocity(b)], physics=self.name, family="cross coupling",
                parameters=[
                    Coefficient("coupling", "1/s", -100 * scale, 100 * scale, scale, linear=True),
                    Coefficient("at speed", "rad/s", speed, speed, 1.0, nuisance=True),
                ],
                starts=[(0.0, speed)], notes={"variant": f"{a.name},{b.name}"},
                predicts="a linear residual across the axes that grows with frequency and with the rotor speed",
                refuted_by="cross motion that is the same at every rotor speed or strongest at standstill",
            )
