"""Regression repeated at the severity found, for faults the residual is not linear in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.settings import NUISANCES, gate_of, nuisances_of, read
from afdsvc.detect.statistics.iterated_regression import iterated


class IteratedRegressionDesign:
    """Settings besides the common ones: what is projected out, as for ``fault_curves``. Keeps the samples of one burst."""

    name = "iterated_regression"
    summary = "regression for parameters the residual is not linear in: stiffness, damping, poles"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out = nuisances_of(values, problem.plant.dt)
        frozen = int(values["frozen_samples"])
        filters = regressors(problem)
        statistic = iterated(problem, filters.settling(1e-3), out)
        gate = gate_of(values)
        return burst_detector(self.name, problem, statistic, gate, values["sure"], frozen, filters, out, regressing=False)
