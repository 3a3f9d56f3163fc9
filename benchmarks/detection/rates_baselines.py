"""Alarm rates of the detectors that know no faults: the residual of a healthy burst is white, so only noise is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rates_cases import RATES, RateCase
from rates_counting import Rate, counted, weighted

from afdsvc.detect.statistics.comparison import Energy
from afdsvc.lti.statespace import Array

PART = 200
BASELINES = ("chi_square", "limit_check")


def baseline_rates(case: RateCase, name: str, seed: int, runs: int) -> dict[float, Rate]:
    """Return the alarm rates per burst: counted at 1/10, weighted below."""
    return {rate: _rate(case, name, rate, seed, runs) for rate in RATES}


def _rate(case: RateCase, name: str, rate: float, seed: int, runs: int) -> Rate:
    found: Energy = case.statistic(name, rate)  # type: ignore[assignment]
    count = case.burst.samples * case.problem.plant.outputs
    empty = replace(found.start(case.burst, case.dt), n=case.burst.samples)
    h = found.decide(empty, case.burst, case.dt)[0].threshold
    rng = np.random.default_rng([seed, 5])
    parts = [PART] * (runs // PART)
    if rate >= 0.1:
        hits = sum(int((_statistic(rng.normal(size=(n, count)), found.peak) > h).sum()) for n in parts)
        return counted(hits, sum(parts))
    push = _peaks if found.peak else _louder
    return weighted(np.concatenate([push(rng, n, count, h) for n in parts]))


def _statistic(e: Array, peak: bool) -> Array:
    return np.asarray(np.abs(e).max(axis=1) if peak else np.sum(e**2, axis=1))


def _louder(rng: np.random.Generator, n: int, count: int, h: float) -> Array:
    """Return weights of noise made so loud that its energy is the threshold on average."""
    s = np.sqrt(h / count)
    energy = _statistic(s * rng.normal(size=(n, count)), peak=False)
    return np.where(energy > h, np.exp(count * np.log(s) - 0.5 * energy * (1 - 1 / s**2)), 0.0)


def _peaks(rng: np.random.Generator, n: int, count: int, h: float) -> Array:
    """Return weights of noise with one sample, drawn at random, pushed to the threshold on either side."""
    e = rng.normal(size=(n, count))
    e[np.arange(n), rng.integers(count, size=n)] += h * rng.choice([-1.0, 1.0], size=n)
    ratio = np.mean(np.cosh(h * e), axis=1) * np.exp(-0.5 * h**2)
    return np.where(_statistic(e, peak=True) > h, 1 / ratio, 0.0)
