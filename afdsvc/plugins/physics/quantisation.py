"""Quantisation: readings that come in steps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output


def stepped(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The reading rounded to the nearest multiple of the step."""
    out[0] += p[0] * math.floor(z[0] / p[0] + 0.5) - z[0]


class Quantisation:
    """Steps in every output whose values lie on a grid."""

    name = "quantisation"
    summary = "readings that come in steps of a converter or an encoder"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output whose recorded values lie on a grid."""
        for port in machine.outputs:
            if port.step > 0:
                step = Coefficient("step", port.unit, port.step, port.step, port.step)
                yield at_output(
                    port, stepped, physics=self.name, family="sensor curve", parameters=[step], starts=[(port.step,)],
                    predicts="values on a grid, and an error spread evenly over one step",
                    refuted_by="values between the grid points",
                )
