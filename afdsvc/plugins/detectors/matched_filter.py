"""Matched filter: the burst's lines against the phases of all faults at several severities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.matched import MatchedFilter
from afdsvc.detect.settings import Range, gate_of, read
from afdsvc.detect.watch import burst_detector


class MatchedFilterDesign:
    """Settings besides the common ones: ``severities``, how many steps from small to total loss are in the set."""

    name = "matched_filter"
    summary = "burst lines against the phases of all faults; threshold for the largest of them"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, {"severities": Range(8, 1, 100, whole=True)})
        low, high = problem.severity_range
        steps = np.linspace(high, low, int(values["severities"]) + 1)[1:]
        statistic = MatchedFilter(problem, tuple(float(v) for v in steps))
        frozen = int(values["frozen_samples"])
        return burst_detector(self.name, problem, statistic, gate_of(values), values["sure"], frozen)
