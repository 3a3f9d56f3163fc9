"""Cross-coupled stiffness: deflection of one axis pushes the other, as in fluid films and seals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_machine, placed, state, velocity


def swirl(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k q2`` on the first axis and ``+k q1`` on the second; with a third signal in proportion to it over its reference."""
    share = p[0] * (z[2] / p[1] if len(z) > 2 else 1.0)
    out[0] -= share * z[1]
    out[1] += share * z[0]


class CrossCoupledStiffness:
    """A skew-symmetric coupling of positions, constant and in proportion to the rotor speed, for every pair of axes."""

    name = "cross_coupled_stiffness"
    summary = "positions of two axes coupled with opposite signs"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per pair of axes, and one that follows the rotor speed where that varies."""
        aux = machine.aux.get("speed")
        speed = (math.hypot(aux.mean, aux.rms) or 1.0) if aux else 1.0
        follows = aux is not None and aux.rms > 1e-3 * abs(aux.mean)
        for (a, p), (b, q) in combinations(placed(machine), 2):
            scale = 0.05 * min(a.push / q.rms, b.push / p.rms)
            for with_speed in (False, True) if follows else (False,):
                reads = [state(p), state(q), *([Signal("aux", aux.index)] if with_speed and aux else [])]
                yield at_machine(
                    "force", swirl, reads, [velocity(a), velocity(b)], physics=self.name, family="cross coupling",
                    parameters=[
                        Coefficient("coupling", "1/s^2", -100 * scale, 100 * scale, scale, linear=True),
                        Coefficient("at speed", "rad/s", speed, speed, 1.0, nuisance=True),
                    ],
                    starts=[(0.0, speed)], notes={"variant": f"{a.name},{b.name}" + (",speed" if with_speed else "")},
                    predicts="a linear residual across the axes that is strongest below the resonances, one mode losing damping",
                    refuted_by="cross motion that grows with frequency",
                )
