"""Maximum likelihood on fault curves, with what nobody wants to see projected out first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.matched import MatchedFilter
from afdsvc.detect.settings import Range, gate_of, read
from afdsvc.detect.watch import burst_detector


class FaultCurvesDesign:
    """Settings besides the common ones: ``drift`` (1: constant and slope), ``mains_hz`` with ``mains_harmonics``, and
    ``rotor_orders`` (waves at 1 to that many times the rotor angle, from ``aux_angle``) are projected out."""

    name = "fault_curves"
    summary = "nearest point on every fault's curve, after drift, mains and rotor-synchronous waves are taken out"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        own = {
            "drift": Range(0, 0, 1, whole=True),
            "mains_hz": Range(0.0, 0.0, 1000.0),
            "mains_harmonics": Range(3, 1, 20, whole=True),
            "rotor_orders": Range(0, 0, 20, whole=True),
        }
        values = read(self.name, settings, own)
        mains = _mains(values["mains_hz"], int(values["mains_harmonics"]), problem.plant.dt)
        orders = tuple(range(1, int(values["rotor_orders"]) + 1))
        statistic = MatchedFilter(problem, (), bool(values["drift"]), mains, orders, likelihood=True)
        frozen = int(values["frozen_samples"])
        return burst_detector(self.name, problem, statistic, gate_of(values), values["sure"], frozen)


def _mains(hz: float, harmonics: int, dt: float) -> tuple[float, ...]:
    """Return the angular frequencies of mains hum below Nyquist."""
    return tuple(2 * math.pi * hz * k for k in range(1, harmonics + 1) if 0 < hz * k < 0.5 / dt)
