"""Sensor offset: a reading that is shifted by a constant."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output


def offset(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y + b``."""
    out[0] += p[0]


class SensorOffset:
    """A constant shift of every output."""

    name = "sensor_offset"
    summary = "a reading shifted by a constant"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        for port in machine.outputs:
            scale = 0.1 * machine.residual[port.index] + 1e-3 * port.rms
            yield at_output(
                port, offset, physics=self.name, family="offset", starts=[(0.0,)],
                parameters=[Coefficient("offset", port.unit, -1e4 * scale, 1e4 * scale, scale, linear=True)],
                predicts="a shift of the mean of this output alone, the same at every level",
                refuted_by="a shift that shows in other outputs too, or that the controller answers",
            )
