"""Exact regression: the whitened residual on what each fault would add, from the measured input."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.features.shared_filter import shared
from afdsvc.detect.settings import NUISANCES, gate_of, nuisances_of, read
from afdsvc.detect.statistics.regression import regression


class RegressionDesign:
    """Settings besides the common ones: what is projected out, as for ``fault_curves``."""

    name = "regression"
    summary = "residual on what each fault would add, from the measured input; uses the loop's own noise too"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out, frozen = nuisances_of(values, problem.plant.dt), int(values["frozen_samples"])
        filters = regressors(problem)
        statistic = regression(problem, shared(filters), out)
        return burst_detector(self.name, problem, statistic, gate_of(values), values["sure"], frozen, filters, out)
