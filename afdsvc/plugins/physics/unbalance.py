"""Unbalance: a force that turns with the rotor and grows with the square of its speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import permutations
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_machine, force, velocity


def turning(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``speed^2 (a cos + b sin)`` of the rotor angle on the first axis, a quarter turn later on the second."""
    phase = z[0] + 0.5 * dt * z[1]
    c, s = math.cos(phase), math.sin(phase)
    rate = (z[1] / p[2]) ** 2
    out[0] += rate * (p[0] * c + p[1] * s)
    if len(out) > 1:
        out[1] += rate * (p[0] * s - p[1] * c)


class Unbalance:
    """A rotating force on every axis, and turning from one axis to another for every pair."""

    name = "unbalance"
    summary = "a force that turns with the rotor"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return hypotheses when rotor angle and speed are recorded, both senses of rotation for every pair of axes."""
        if "angle" not in machine.aux or "speed" not in machine.aux or not machine.axes:
            return
        pairs: list[tuple[Axis, ...]] = list(permutations(machine.axes, 2)) or [(machine.axes[0],)]
        speed = math.hypot(machine.aux["speed"].mean, machine.aux["speed"].rms) or 1.0
        for axes in pairs:
            scale = 0.05 * axes[0].push
            pair = [force(axes[0], f"{part} force", -1e3 * scale, 1e3 * scale, scale, linear=True) for part in ("cosine", "sine")]
            yield at_machine(
                "force", turning, [Signal("aux", machine.aux["angle"].index), Signal("aux", machine.aux["speed"].index)],
                [velocity(a) for a in axes], physics=self.name, family="rotation",
                parameters=[*pair, Coefficient("at speed", "rad/s", speed, speed, 1.0, nuisance=True)],
                starts=[(0.0, 0.0, speed)], notes={"variant": " to ".join(a.name for a in axes)},
                predicts="a line at the rotor speed that grows with the square of the speed and passes the machine's resonances",
                refuted_by="a line at the rotor speed that is the same at every speed (then it is run-out)",
            )
