"""Rare alarms of the line detectors on machines with parameters drawn: only the coordinates of the lines are drawn.

Their mean and covariance follow from the machine's own response at the lines. Two thirds of the machines come from wider densities
than stated; on each, noise is pushed along the directions likeliest to alarm. Both are weighted back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drawn_cases import Doubtful
from rates_counting import Rate, weighted
from rates_lines import LINE_DETECTORS, alarm_region
from scipy.special import logsumexp, ndtr

from afdsvc.detect.model_uncertainty import model_doubt
from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.lti.statespace import Array

SCALES = (1.0, 1.7, 3.0)  # times the stated uncertainty, in equal parts
PUSHES = 64  # directions noise is pushed along, at most


def wider(rng: np.random.Generator, count: int) -> tuple[Array, float]:
    """Return standardised deviations drawn for one machine and the logarithm of their weight."""
    scales = np.array(SCALES)
    z = rng.normal(size=count) * scales[int(rng.integers(len(scales)))]
    return z, float(-logsumexp(0.5 * float(z @ z) * (1 - scales**-2) - count * np.log(scales)) + np.log(len(scales)))


def line_rates(
    doubtful: Doubtful, rates: tuple[float, ...], machines: int, each: int, seed: int
) -> dict[tuple[str, float], list[Rate]]:
    """Return the rates with the model doubtful and taken as certain, of every line detector at every promised rate."""
    case = doubtful.case
    lines = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
    truth = replace(case.problem, augmented=doubtful.together, uncertain=None, uncertainty={}, severity_range=(-1.0, 1.0))
    curves, R = fault_curves(truth, lines), np.linalg.cholesky(case.line_sums().G).T
    sides = [(name, rate, k) for name in LINE_DETECTORS for rate in rates for k in range(2)]
    cases = (doubtful.case, doubtful.certain)
    regions = {side: alarm_region(cases[side[2]], side[0], side[1]) for side in sides}
    factors = [
        np.linalg.cholesky(np.eye(len(R) * case.problem.plant.outputs) + model_doubt(c.problem, lines, R)) for c in cases
    ]
    rng, weights = np.random.default_rng([seed, 12]), {side: np.zeros(machines) for side in sides}
    for i in range(machines):
        z, log_prior = wider(rng, len(doubtful.deviations))
        drawn = {name: float(sd * v) for (name, sd), v in zip(doubtful.deviations.items(), z, strict=True)}
        point, covariance = curves.together(drawn)
        mean, root = (R @ point).ravel(), np.linalg.cholesky(covariance)
        for side in sides:
            own_mean, own_root = (np.linalg.solve(factors[side[2]], x) for x in (mean, root))
            weights[side][i] = np.exp(log_prior) * _share(*regions[side], own_mean, own_root, each, rng)
    return {(name, rate): [weighted(weights[name, rate, k]) for k in range(2)] for name in LINE_DETECTORS for rate in rates}


def _share(e: Array, h: Array, mean: Array, root: Array, each: int, rng: np.random.Generator) -> float:
    """Return an unbiased estimate of the probability that any ``<e_k, mean + root n>`` exceeds its height."""
    axis = e @ root
    sd = np.linalg.norm(axis, axis=1)
    far = (h - e @ mean) / sd
    best = np.argsort(far)[:: max(len(far) // PUSHES, 1)][:PUSHES]
    tails = np.maximum(ndtr(-far[best]), 1e-30)
    p, shift = tails / tails.sum(), np.maximum(far[best], 0.0)[:, None] * axis[best] / sd[best, None]
    n = rng.normal(size=(each, len(mean))) + shift[rng.choice(len(p), size=each, p=p)]
    ratio = logsumexp(np.log(p) + n @ shift.T - 0.5 * np.sum(shift**2, axis=1), axis=1)
    alarms = (n @ axis.T > h - e @ mean).any(axis=1)
    return float(np.mean(np.where(alarms, np.exp(-ratio), 0.0)))
