"""Eccentricity: a speed that repeats along the way gone, as that of the surface of a roll that is out of round."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_input, quantity


def out_of_round(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``u + c v m[0]`` in the middle of the step, ``v`` the last signal read; ``m`` turns by ``p[0]`` per unit of the integral of ``v``."""
    v = z[len(z) - 1]
    half = 0.5 * p[0] * v * dt
    c, s = math.cos(half), math.sin(half)
    for turn in range(2):
        m[0], m[1] = c * m[0] - s * m[1], s * m[0] + c * m[1]
        if turn == 0:
            out[0] += p[1] * v * m[0]


class Eccentricity:
    """A wave along the integral of every input that is a speed, a share of it in that input or in another speed: a roll, a wheel or a gear that is out
    of round."""

    name = "eccentricity"
    summary = "a speed that repeats with every turn of a roll or wheel that is out of round"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input along whose integral the residual has waves and input that is a speed, begun at these."""
        for way in machine.inputs:
            waves, size = machine.waves.get(Signal("u", way.index), ()), max(way.rms, abs(way.mean))
            for port in machine.inputs if waves else ():
                if quantity(port.unit) == "velocity":
                    other = port.index != way.index
                    yield at_input(
                        port, out_of_round, [Signal("u", way.index)] if other else [], memory=2, unsettled=2, lasting=True, physics=self.name, family="ripple",
                        parameters=[
                            Coefficient("wave number", f"rad/({way.unit} s)", 0.5 * min(waves), 2 * max(waves), 1e-3 * min(waves)),
                            Coefficient(f"share of {way.name}", f"({port.unit})/({way.unit})" if port.unit != way.unit else "", 1 / size, 1 / size, 1 / size),
                        ],
                        starts=[(k, 1 / size) for k in waves], notes={"variant": way.name} if other else {},
                        predicts="a residual whose frequency follows the speed", refuted_by="a frequency that does not follow the speed",
                    )
