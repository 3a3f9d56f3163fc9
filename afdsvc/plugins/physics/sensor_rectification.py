"""Sensor rectification: a sensor with another gain for positive than for negative motion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output


def rectified(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y + c |y|``."""
    out[0] += p[0] * abs(z[0])


class SensorRectification:
    """A share of the absolute value in every output."""

    name = "sensor_rectification"
    summary = "a sensor whose gain differs between the two directions"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        for port in machine.outputs:
            yield at_output(
                port, rectified, physics=self.name, family="sensor curve", starts=[(0.0,)],
                parameters=[Coefficient("share", "", -1.0, 1.0, 0.02, linear=True)],
                predicts="even distortion in proportion to the level, in this output alone",
                refuted_by="even distortion that grows with the square of the level",
            )
