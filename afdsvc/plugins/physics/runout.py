"""Run-out: a shaft surface that is not round, read by the sensors as motion."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine, Signal
from afdsvc.plugins.physics.attach import at_output


def uneven(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The first three harmonics of the rotor angle in the reading."""
    for k in range(3):
        out[0] += p[2 * k] * math.cos((k + 1) * z[1]) + p[2 * k + 1] * math.sin((k + 1) * z[1])


class Runout:
    """Harmonics of the rotor angle in every output."""

    name = "runout"
    summary = "a shaft surface that is not round, read as motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output when the rotor angle is recorded."""
        if "angle" not in machine.aux:
            return
        for port in machine.outputs:
            scale = 0.2 * float(machine.residual[port.index])
            parts = [f"{order} {part}" for order in ("first", "second", "third") for part in ("cosine", "sine")]
            yield at_output(
                port, uneven, [Signal("aux", machine.aux["angle"].index)], physics=self.name, family="rotation",
                parameters=[Coefficient(n, port.unit, -1e3 * scale, 1e3 * scale, scale, linear=True) for n in parts],
                starts=[(0.0,) * 6],
                predicts="lines at the rotor speed and its multiples in this output that are the same at every speed",
                refuted_by="a line that grows with the speed or shows in the motion of other axes (then it is unbalance)",
            )
