"""Sensor nonlinearity: a curved characteristic of a sensor."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output, constant, operating_point
from afdsvc.plugins.physics.static_nonlinearity import curve_about


def _curve(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``a2 w^2 + a3 w^3`` in units of the rms ``r``: ``w = y / r``, times r."""
    w = z[0] / p[2]
    out[0] += (p[0] * w * w + p[1] * w * w * w) * p[2]


class SensorNonlinearity:
    """A curved characteristic at every output; neither term is larger than the reading itself at its peak."""

    name = "sensor_nonlinearity"
    summary = "a reading that is a smooth curve of the motion"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per output, two where it has one sign."""
        for port in machine.outputs:
            r = max(port.rms, 1e-300)
            for law, reach, notes, centre in (
                (_curve, max(port.peak, r), {}, []),
                (curve_about, port.reach, {"variant": "about the operating point", "of": ""}, [operating_point(port), constant("shift", port.unit, 0.0)]),
            )[: 1 if port.reverses else 2]:
                top = reach / r
                yield at_output(
                    port, law, physics=self.name, family="sensor curve", notes=notes, description=True,
                    parameters=[
                        Coefficient("quadratic share", "", -1 / top, 1 / top, 0.05 / top, linear=True),
                        Coefficient("cubic share", "", -1 / top**2, 1 / top**2, 0.05 / top**2, linear=True),
                        constant("reference", port.unit, r), *centre,
                    ],
                    starts=[(0.0, 0.0, r, *(c.low for c in centre))],
                    predicts="distortion of this output in phase with the output itself, the other outputs unchanged",
                    refuted_by="distortion that shows in several outputs or that resonates",
                )
