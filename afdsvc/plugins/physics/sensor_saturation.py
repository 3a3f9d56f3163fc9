"""Sensor saturation: readings beyond a limit are cut."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from afdsvc.api.physics import Coefficient, Hypothesis, Machine
from afdsvc.plugins.physics.attach import at_output
from afdsvc.plugins.physics.saturation import SHARP, SOFT, cut_above, soft_limit, two_limits


class SensorSaturation:
    """Limits at every output: the same on both sides, above only, or one on each side."""

    name = "sensor_saturation"
    summary = "readings beyond a limit are cut"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return three hypotheses per output."""
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
            low, high = port.mean - 3 * port.rms, port.mean + 3 * port.rms
            top = Coefficient("limit", port.unit, low, 1.2 * peak, 0.05 * port.rms)
            starts = [(port.mean + s * port.rms,) for s in (0.5, 1.2, 2.0)]
            yield at_output(port, cut_above, parameters=[top], starts=starts, notes={"variant": "above", "of": ""}, **words)
            bottom = Coefficient("lower limit", port.unit, -1.2 * peak, high, 0.05 * port.rms)
            yield at_output(
                port, two_limits, parameters=[replace(top, name="upper limit"), bottom], notes={"variant": "asymmetric", "of": ""},
                starts=[(port.mean + a * port.rms, port.mean - b * port.rms) for a in (0.7, 1.4, 2.2) for b in (0.7, 1.4, 2.2)], **words,
            )
