"""Saturation: commands beyond a limit are cut."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_input

SHARP, SOFT = 1e-3, 0.4  # shares of the limit over which the corner may be rounded


def saturation(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The input is held within ``+-limit``, the corner rounded by a parabola over ``+-knee limit``."""
    corner = p[1] * p[0]
    beyond = abs(z[0]) - p[0]
    if beyond > -corner:
        lost = beyond if beyond >= corner else (beyond + corner) ** 2 / (4 * corner)
        out[0] -= math.copysign(lost, z[0])


class Saturation:
    """A limit at every input, inside the range the recordings use."""

    name = "saturation"
    summary = "commands beyond a limit have no further effect"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per input, started at limits between a third and nearly all of the largest command."""
        for port in machine.inputs:
            peak = port.peak
            yield at_input(
                port, saturation, physics=self.name, family="input curve",
                parameters=[
                    Coefficient("limit", port.unit, 0.02 * peak, 1.4 * peak, 0.02 * peak),
                    Coefficient("knee", "", SHARP, SOFT, 0.05, nuisance=True),
                ],
                starts=[(share * peak, 0.1) for share in (0.35, 0.6, 0.85, 0.95)],
                predicts="nothing below a level; above it missing peaks of the input",
                refuted_by="distortion in recordings whose input never reaches the limit",
            )
