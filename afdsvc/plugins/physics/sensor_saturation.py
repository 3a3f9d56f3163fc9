"""Sensor saturation: readings beyond a limit are cut."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output
from afdsvc.plugins.physics.saturation import SHARP, SOFT, soft_limit


def cut_above(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """The reading is held below ``limit``."""
    out[0] += min(z[0], p[0]) - z[0]


class SensorSaturation:
    """A limit at every output, on both sides or above only."""

    name = "sensor_saturation"
    summary = "readings beyond a limit are cut"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return two hypotheses per output."""
        for port in machine.outputs:
            words: dict[str, Any] = {
                "physics": self.name, "family": "sensor curve",
                "predicts": "peaks of the reading cut off at the same height in every recording",
                "refuted_by": "readings beyond the limit",
            }
            peak = port.peak
            limit = Coefficient("limit", port.unit, 0.05 * peak, 1.2 * peak, 0.02 * peak)
            knee = Coefficient("knee", "", SHARP, SOFT, 0.05, nuisance=True)
            yield at_output(port, soft_limit, parameters=[limit, knee], starts=[(s * peak, 0.1) for s in (0.5, 0.75, 0.95, 1.05)], **words)
            top = Coefficient("limit", port.unit, port.mean - 3 * port.rms, 1.2 * peak, 0.05 * port.rms)
            starts = [(port.mean + s * port.rms,) for s in (0.5, 1.2, 2.0)]
            yield at_output(port, cut_above, parameters=[top], starts=starts, notes={"variant": "above"}, **words)
