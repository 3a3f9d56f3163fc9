"""Sensor drift: a reading that creeps away with time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output


def drift(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``y + rate (t - levelling t^2)``, ``t`` since the recording began."""
    out[0] += p[0] * (1 - p[1] * m[0]) * m[0]
    m[0] += dt


class SensorDrift:
    """A slow drift of every output, to second order in time: what warms up levels off. None of a machine without inputs (see `ParameterDrift`)."""

    name = "sensor_drift"
    summary = "a reading that moves away slowly, steadily or levelling off"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output."""
        for port in machine.outputs if machine.inputs else ():
            scale = (0.1 * machine.residual[port.index] + 1e-3 * port.rms) / machine.duration
            yield at_output(
                port, drift, physics=self.name, family="offset", memory=1, starts=[(0.0, 0.0), (0.0, 1 / machine.duration)],
                parameters=[
                    Coefficient("rate", f"{port.unit}/s", -1e5 * scale, 1e5 * scale, scale, linear=True),
                    Coefficient("levelling", "1/s", 0.0, 3 / machine.duration, 0.1 / machine.duration, nuisance=True),
                ],
                predicts="a residual of this output that grows with time whatever the excitation",
                refuted_by="a residual that is the same at the beginning and at the end",
            )
