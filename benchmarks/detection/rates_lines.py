"""Alarm rates of the detectors that look at excited lines: alarm where any ``<e_k, z>`` exceeds its height.

Line coordinates z of a healthy machine are standard normal, because the residual is white and the coordinates are
orthonormal combinations of it; `rates_real` shows it on simulated bursts. Directions and heights are the detectors' own.
"""

from __future__ import annotations

import numpy as np
from rates_cases import RateCase
from rates_counting import Rate, counted, weighted
from scipy.special import logsumexp, ndtr

from afdsvc.detect.model_uncertainty import models
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.comparison import UNSEEN, PublishedFilter
from afdsvc.detect.statistics.likelihood_ratio import heights
from afdsvc.detect.statistics.matched_filter import MatchedFilter
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.lti.statespace import Array

PART = 20_000
PROPOSALS = 256  # directions the draws are pushed along: the likeliest to alarm

LINE_DETECTORS = ("matched_filter", "fault_curves")
PUBLISHED = ("published_a0", "published_a_phi")


def alarm_region(case: RateCase, name: str, rate: float) -> tuple[Array, Array]:
    """Return unit directions ``(K, D)`` and heights ``(K,)`` of a detector at a promised rate."""
    return _published(case, name, rate) if name in PUBLISHED else _lines(case, name, rate)


def _lines(case: RateCase, name: str, rate: float) -> tuple[Array, Array]:
    found: MatchedFilter = case.statistic(name, rate)  # type: ignore[assignment]
    _, curves, data = found._reduced(case.line_sums(), case.burst)  # noqa: SLF001 - the detector's own preparation
    problem = found.problem
    waves = found.line_test.waves(curves, data, reachable(problem))
    lines = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
    allowed = models(problem, lines, data.R) if problem.uncertainty else None
    h = found.line_test.threshold(waves, data, allowed, rate)
    length = np.linalg.norm(waves, axis=1)
    if found.likelihood:
        return waves / length[:, None], heights(length, h**2 / 2)
    return waves / length[:, None], np.full(len(waves), h)


def _published(case: RateCase, name: str, rate: float) -> tuple[Array, Array]:
    """Return the published filter's region; z are standardised line sums of all outputs, flattened as ``(2 L, p)``."""
    found: PublishedFilter = case.statistic(name, rate)  # type: ignore[assignment]
    waves, sums, Xi = found._amplitudes(case.burst), case.line_sums(), np.atleast_2d(found.problem.covariance)  # noqa: SLF001
    root, back, directions, at = np.linalg.cholesky(sums.G), np.linalg.cholesky(Xi), [], []
    for i in range(len(Xi)):
        k = int(np.argmax(np.abs(waves[:, :, i]).max(axis=0)))
        for a in waves[:, k, i]:
            if abs(a) > UNSEEN * np.abs(waves).max():
                u = np.exp(-1j * np.angle(a))  # Re(u (s + j c)) = Re u s - Im u c
                form = np.outer(u.real * root[2 * k] - u.imag * root[2 * k + 1], back[i]).ravel()
                length = float(np.linalg.norm(form))
                directions.append(form / length)
                at.append(np.sqrt(Xi[i, i] * sums.n / 2) * tail_point(rate) / length)
    return np.array(directions), np.array(at)


def line_rate(case: RateCase, name: str, rate: float, seed: int, runs: int) -> Rate:
    """Return the alarm rate of a line detector: counted from 1/100 on, weighted below."""
    return region_rate(*alarm_region(case, name, rate), seed, runs, counting=rate >= 0.01)


def region_rate(e: Array, h: Array, seed: int, runs: int, counting: bool) -> Rate:
    """Return the probability that a standard normal z has any ``<z, e_k> > h_k``."""
    rng = np.random.default_rng([seed, 1])
    parts = [PART] * (runs // PART) + ([runs % PART] if runs % PART else [])
    if counting:
        return counted(sum(int(_alarms(rng.normal(size=(n, e.shape[1])), e, h).sum()) for n in parts), runs)
    best = np.argsort(h)[:: max(len(h) // PROPOSALS, 1)][:PROPOSALS]
    p = ndtr(-h[best]) / ndtr(-h[best]).sum()
    shift = h[best, None] * e[best]
    found = [_weights(rng, n, e, h, p, shift) for n in parts]
    return weighted(np.concatenate(found))


def _alarms(z: Array, e: Array, h: Array) -> Array:
    return np.asarray((z @ e.T > h).any(axis=1))


def _weights(rng: np.random.Generator, n: int, e: Array, h: Array, p: Array, shift: Array) -> Array:
    """Return likelihood ratios of plain draws over pushed ones where they alarm, 0 elsewhere."""
    z = rng.normal(size=(n, e.shape[1])) + shift[rng.choice(len(p), size=n, p=p)]
    ratio = logsumexp(np.log(p) + z @ shift.T - 0.5 * np.sum(shift**2, axis=1), axis=1)
    return np.where(_alarms(z, e, h), np.exp(-ratio), 0.0)
