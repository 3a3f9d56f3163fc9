"""Matched filter: the burst's lines against the phases of all faults at several severities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.settings import NUISANCES, Range, gate_of, nuisances_of, read
from afdsvc.detect.statistics.matched_filter import MatchedFilter


class MatchedFilterDesign:
    """Settings besides the common ones: ``severities``, how many steps from small to total loss are in the set, and what is
    projected out, as for ``fault_curves``."""

    name = "matched_filter"
    summary = "burst lines against the phases of all faults; threshold for the largest of them"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, {**NUISANCES, "severities": Range(8, 1, 100, whole=True)})
        low, high = problem.severity_range
        steps = np.linspace(high, low, int(values["severities"]) + 1)[1:]
        out, frozen = nuisances_of(values, problem.plant.dt), int(values["frozen_samples"])
        severities = tuple(float(v) for v in steps)
        statistic = MatchedFilter(problem, severities, out.drift, out.mains, out.orders, if_recorded=out.if_recorded)
        gate = gate_of(values)
        return burst_detector(self.name, problem, statistic, gate, values["sure"], frozen, nuisances=out, regressing=False)
