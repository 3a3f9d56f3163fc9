"""Quantisation: readings, or what an actuator makes of commands, that come in steps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_output


def _stepped(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The signal rounded to the nearest multiple of the step."""
    out[0] += p[0] * math.floor(z[0] / p[0] + 0.5) - z[0]


class Quantisation:
    """Steps in every output whose values lie on a grid, and of a size to be found in every input."""

    name = "quantisation"
    summary = "readings or commands that come in steps of a converter or an encoder"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output whose recorded values lie on a grid, and one per input."""
        for port in machine.outputs:
            if port.step > 0:
                step = Coefficient("step", port.unit, port.step, port.step, port.step)
                yield at_output(
                    port, _stepped, physics=self.name, family="sensor curve", parameters=[step], starts=[(port.step,)],
                    predicts="values on a grid, and an error spread evenly over one step",
                    refuted_by="values between the grid points",
                )
        for port in machine.inputs:
            low, r = max(2 * port.step, 0.02 * port.rms), port.rms
            yield at_input(
                port, _stepped, physics=self.name, family="input curve", parameters=[Coefficient("step", port.unit, low, max(2 * port.peak, 2 * low), 0.02 * r)],
                starts=[(max(s * r, low),) for s in (0.1, 0.2, 0.4, 0.8, 1.6)],
                predicts="an effect that stays the same while the command changes by less than a step",
                refuted_by="an effect that follows the smallest changes of the command",
            )
