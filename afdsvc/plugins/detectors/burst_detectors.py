"""The detectors that judge a burst: matched filter, fault curves, regression and iterated regression."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.detect.burst_detector import burst_detector
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.features.shared_filter import shared_regressors
from afdsvc.detect.settings import NUISANCES, Range, gate_of, nuisances_of, read
from afdsvc.detect.statistics.iterated_regression import iterated
from afdsvc.detect.statistics.matched_filter import MatchedFilter
from afdsvc.detect.statistics.regression import regression


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


class RegressionDesign:
    """Settings besides the common ones: what is projected out, as for ``fault_curves``."""

    name = "regression"
    summary = "residual on what each fault would add, from the measured input; uses the loop's own noise too"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out, frozen = nuisances_of(values, problem.plant.dt), int(values["frozen_samples"])
        statistic = regression(problem, shared_regressors(problem), out)
        return burst_detector(self.name, problem, statistic, gate_of(values), values["sure"], frozen, out)


class IteratedRegressionDesign:
    """Settings besides the common ones: what is projected out, as for ``fault_curves``. Keeps the samples of one burst."""

    name = "iterated_regression"
    summary = "regression for parameters the residual is not linear in: stiffness, damping, poles"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out = nuisances_of(values, problem.plant.dt)
        frozen = int(values["frozen_samples"])
        statistic = iterated(problem, regressors(problem).settling(1e-3), out)
        return burst_detector(self.name, problem, statistic, gate_of(values), values["sure"], frozen, out, regressing=False)
