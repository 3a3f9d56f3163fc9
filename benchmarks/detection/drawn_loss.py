"""What it costs to allow for a model that is only roughly right: deflection lost, and the probability of detection left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from drawn_cases import Doubtful
from rates_counting import Rate, counted
from rates_lines import alarm_region
from scipy.optimize import brentq

from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.excite.expected_detection import ExpectedDetection, expected_detection

RATE = 0.01  # false alarms per burst at which probabilities are compared
WANTED = 0.9  # probability of detection of the severity looked at, were the model certain


@dataclass(frozen=True)
class Loss:
    """One fault: the severity looked at, deflections and stated detection probabilities with a certain and a doubtful model, and
    the detection counted on machines whose parameters are drawn (None: the burst cannot show the fault that well)."""

    case: str
    fault: str
    severity: float
    deflections: tuple[float, float]
    stated: tuple[float, float]
    counted: Rate


def losses(doubtful: Doubtful, runs: int, seed: int) -> list[Loss]:
    """Return the losses of every fault that the certain model would find with probability `WANTED` at some severity."""
    sharp, vague = (_prospect(case.problem, doubtful) for case in (doubtful.certain, doubtful.case))
    out = []
    for i, fault in enumerate(doubtful.case.problem.fault_names):
        severity = _severity(doubtful, sharp, fault)
        if severity is not None:
            found = _counted(doubtful, fault, severity, runs, np.random.default_rng([seed, i]))
            deflections = sharp.deflection(fault, severity), vague.deflection(fault, severity)
            stated = _stated(sharp, fault, severity), _stated(vague, fault, severity)
            out.append(Loss(doubtful.case.key, fault, severity, deflections, stated, found))
    return out


def _prospect(problem: object, doubtful: Doubtful) -> ExpectedDetection:
    lines = sorted(doubtful.case.burst.lines, key=lambda line: line.omega)
    return expected_detection(problem, lines, doubtful.case.line_sums().n)  # type: ignore[arg-type]


def _stated(seen: ExpectedDetection, fault: str, severity: float) -> float:
    return seen.detection(fault, severity, seen.ratio_threshold(RATE))


def _severity(doubtful: Doubtful, sharp: ExpectedDetection, fault: str) -> float | None:
    h, low = sharp.ratio_threshold(RATE), 0.99 * reachable(doubtful.certain.problem)[fault][0]

    def excess(severity: float) -> float:
        return sharp.detection(fault, severity, h) - WANTED

    return float(brentq(excess, low, -1e-3, xtol=1e-4)) if excess(low) > 0 else None


def _counted(doubtful: Doubtful, fault: str, severity: float, runs: int, rng: np.random.Generator) -> Rate:
    """Return how often fault_curves alarms: machines drawn one by one, their lines with the noise each of them makes."""
    case = doubtful.case
    lines = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
    truth = replace(case.problem, augmented=doubtful.together, uncertain=None, uncertainty={}, severity_range=(-1.0, 1.0))
    curves, R = fault_curves(truth, lines), np.linalg.cholesky(case.line_sums().G).T
    e, h = alarm_region(case, "fault_curves", RATE)
    factor = np.linalg.cholesky(np.eye(R.shape[0] * case.problem.plant.outputs) + _prospect(case.problem, doubtful).doubt)
    hits = 0
    for _ in range(runs):
        drawn = {name: float(sd * rng.normal()) for name, sd in doubtful.deviations.items()}
        point, covariance = curves.together({**drawn, fault: severity})
        z = (R @ point).ravel() + np.linalg.cholesky(covariance) @ rng.normal(size=len(covariance))
        hits += bool((e @ np.linalg.solve(factor, z) > h).any())
    return counted(hits, runs)
