"""Maximum likelihood on fault curves, after projecting out nuisance directions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.settings import NUISANCES, gate_of, nuisances_of, read
from afdsvc.detect.statistics.matched_filter import MatchedFilter


class FaultCurvesDesign:
    """Settings besides the common ones: ``drift`` (1: constant and slope), ``mains_hz`` with ``mains_harmonics``, and
    ``rotor_orders`` (waves at 1 to that many times the rotor angle, from ``aux_angle``; -1: two when it is recorded) are
    projected out."""

    name = "fault_curves"
    summary = "nearest point on every fault's curve, after drift, mains and rotor-synchronous waves are taken out"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out, frozen = nuisances_of(values, problem.plant.dt), int(values["frozen_samples"])
        statistic = MatchedFilter(
            problem, (), out.drift, out.mains, out.orders, likelihood=True, if_recorded=out.if_recorded
        )
        gate = gate_of(values)
        return burst_detector(self.name, problem, statistic, gate, values["sure"], frozen, nuisances=out, regressing=False)
