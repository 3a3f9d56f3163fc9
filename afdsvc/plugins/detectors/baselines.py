"""Detectors to compare with: as published, fault-blind ones, and a bank of models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.api.detection import DetectionProblem, Detector, DetectorDesign
from afdsvc.detect.burst_detector import BurstStatistic, burst_detector
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.settings import NUISANCES, Range, gate_of, nuisances_of, read
from afdsvc.detect.statistics.comparison import Energy, PublishedFilter, bank


@dataclass(slots=True)
class PublishedDesign:
    """The thesis' matched filter with statistic A_0 or A_phi. Settings besides the common ones: ``severity`` of the
    design, and what is projected out, as for ``fault_curves``."""

    name: str
    summary: str
    follow_phase: bool

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, {**NUISANCES, "severity": Range(-0.1, -1.0, -0.001)})
        statistic = PublishedFilter(problem, self.follow_phase, values["severity"], nuisances_of(values, problem.plant.dt))
        return _framed(self.name, problem, statistic, values)


@dataclass(slots=True)
class EnergyDesign:
    """Fault-blind: chi-squared energy of the residual or, with ``peak``, its largest sample. Settings besides the common ones: what
    is projected out, as for ``fault_curves``."""

    name: str
    summary: str
    peak: bool

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, NUISANCES)
        out = nuisances_of(values, problem.plant.dt)
        statistic = Energy(problem.plant.outputs, problem.false_alarms.per_burst, self.peak, out)
        return _framed(self.name, problem, statistic, values)


class ModelBankDesign:
    """Settings besides the common ones: ``severities``, models for every fault from small to total loss, and what is
    projected out, as for ``fault_curves``."""

    name = "model_bank"
    summary = "one predictor for every fault at several severities; the likeliest wins"

    def design(self, problem: DetectionProblem, settings: Mapping[str, Any]) -> Detector:
        """Return the detector; raises `BadInput` for a setting that is unknown or out of range."""
        values = read(self.name, settings, {**NUISANCES, "severities": Range(10, 1, 100, whole=True)})
        low, high = problem.severity_range
        steps = [float(v) for v in np.linspace(high, low, int(values["severities"]) + 1)[1:]]
        statistic = bank(problem, steps, regressors(problem).settling(), nuisances_of(values, problem.plant.dt))
        return _framed(self.name, problem, statistic, values)


def _framed(name: str, problem: DetectionProblem, statistic: BurstStatistic, values: Mapping[str, float]) -> Detector:
    frozen, out, gate = int(values["frozen_samples"]), nuisances_of(values, problem.plant.dt), gate_of(values)
    return burst_detector(name, problem, statistic, gate, values["sure"], frozen, nuisances=out, regressing=False)


DESIGNS: tuple[DetectorDesign, ...] = (
    PublishedDesign("published_a0", "the thesis' matched filter, one amplitude for all phases (5.21)", False),
    PublishedDesign("published_a_phi", "the thesis' matched filter, the amplitude of the phase found (P4 42)", True),
    EnergyDesign("chi_square", "energy of the white residual; knows no faults", False),
    EnergyDesign("limit_check", "largest sample of the open-loop residual; knows no faults", True),
    ModelBankDesign(),
)
