"""Quantisation: readings, or what an actuator makes of commands, that come in steps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input, at_output, constant


def _stepped(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The signal rounded to the nearest multiple of the step."""
    out[0] += p[0] * math.floor(z[0] / p[0] + 0.5) - z[0]


def read_in_steps(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The mean of the reading rounded to steps ``p0`` from ``p1`` on, normal noise of ``p2`` steps before the rounding (Widrow and Kollar 2008)."""
    x = (z[0] - p[1]) / p[0]
    if p[2] < 0.04:  # as good as none; above it the twelfth term is less than a thousandth of the first
        out[0] += p[0] * (math.floor(x + 0.5) - x)
    else:
        for k in range(1, 13):
            out[0] += p[0] * (-1) ** k * math.exp(-2 * (math.pi * k * p[2]) ** 2) * math.sin(2 * math.pi * k * x) / (math.pi * k)


class Quantisation:
    """Steps in every output whose values lie on a grid, and of a size to be found in every input."""

    name = "quantisation"
    summary = "readings or commands that come in steps of a converter or an encoder"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output whose recorded values lie on a grid, and one per input."""
        for port in machine.outputs:
            if port.step > 0:
                noise = Coefficient("noise before the steps", "steps", 0.02, 1.0, 0.02)
                yield at_output(
                    port, read_in_steps, physics=self.name, family="sensor curve",
                    parameters=[constant("step", port.unit, port.step), constant("origin", port.unit, port.origin), noise],
                    starts=[(port.step, port.origin, s) for s in (0.1, 0.25)],
                    predicts="values on a grid, and an error spread evenly over one step",
                    refuted_by="values between the grid points",
                )
        for port in machine.inputs:
            low, r = max(2 * port.step, 0.02 * port.rms), port.rms
            yield at_input(
                port, _stepped, physics=self.name, family="input curve", parameters=[Coefficient("step", port.unit, low, max(r, 2 * low), 0.02 * r)],  # beyond it are curves of two or three levels
                starts=[(max(s * r, low),) for s in np.geomspace(0.1, 1.0, 19)],  # a step that is off by an eighth is another staircase three steps up
                predicts="an effect that stays the same while the command changes by less than a step",
                refuted_by="an effect that follows the smallest changes of the command",
            )
