"""Thresholds and designed false alarms per hour of the built-in detectors for one burst."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.detect.features.whiteness_gate import Gate
from afdsvc.detect.statistics.active_cusum import ActiveCusum
from afdsvc.detect.statistics.passive_cusum import passive_detector
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.expected_detection import burst_detection


def thresholds(problem: DetectionProblem, burst: Burst, alarms: Mapping[str, FalseAlarms]) -> dict[str, float]:
    """Return the threshold of every detector in ``alarms`` at its own promised rate; foreign detectors are left out."""
    return {
        name: _THRESHOLDS[name](replace(problem, false_alarms=promised), burst)
        for name, promised in alarms.items()
        if name in _THRESHOLDS
    }


def alarms_per_hour(alarms: Mapping[str, FalseAlarms], bursts_per_hour: float) -> float:
    """Return the false alarms per hour of all detectors together; ``passive_...`` ones run always, others per burst."""
    rates = [
        promised.per_hour if name.startswith("passive") else promised.per_burst * bursts_per_hour
        for name, promised in alarms.items()
    ]
    return float(sum(rates))


def _largest(problem: DetectionProblem, burst: Burst) -> float:
    return burst_detection(problem, burst).threshold(problem.false_alarms.per_burst)


def _ratio(problem: DetectionProblem, burst: Burst) -> float:
    return burst_detection(problem, burst).ratio_threshold(problem.false_alarms.per_burst)


def _regression(problem: DetectionProblem, burst: Burst) -> float:
    """Return the threshold for the information expected; the detector uses what it finds."""
    noise, K = noise_driven(problem), len(problem.fault_names)
    gram = (noise.gram + noise.active_gram(burst))[:K, :K]
    seen = np.diag(gram) > 0
    gram = gram[np.ix_(seen, seen)]
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return maximum.maximum_threshold(vectors * np.sqrt(np.maximum(values, 0.0)), problem.false_alarms.per_burst)


def _cusum(problem: DetectionProblem, burst: Burst) -> float:
    return ActiveCusum(problem).plan(burst, problem.plant.dt).boundary


def _passive(problem: DetectionProblem, burst: Burst) -> float:
    return passive_detector("passive_cusum", problem, Gate(), -0.3, 0.0, 0.99, 100).boundary


_THRESHOLDS: dict[str, Callable[[DetectionProblem, Burst], float]] = {
    "matched_filter": _largest,
    "fault_curves": _ratio,
    "regression": _regression,
    "cusum": _cusum,
    "passive_cusum": _passive,
}
