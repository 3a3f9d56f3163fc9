"""Rates with their 99 per cent intervals: counted, or weighted by importance sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, norm

from afdsvc.lti.statespace import Array

LEVEL = 0.99
SURE = float(norm.isf((1 - LEVEL) / 2))
FEWEST = 100.0  # effective sample size below which a weighted estimate is refused


@dataclass(frozen=True)
class Rate:
    """A rate with its 99 per cent interval; ``effective`` is the number of alarms, or for weighted runs Kish's effective
    number of alarms ``(sum w)^2 / sum w^2``. ``weighted`` rates with few effective alarms are refused."""

    value: float
    low: float
    high: float
    runs: int
    effective: float
    weighted: bool

    @property
    def refused(self) -> bool:
        return self.weighted and self.value > 0 and self.effective < FEWEST

    def inside(self, promised: float) -> bool:
        return not self.refused and self.low <= promised <= self.high

    @property
    def method(self) -> str:
        return "importance sampling" if self.weighted else "counted"

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


def counted(hits: int, of: int) -> Rate:
    """Return a binomial share with its exact interval (Clopper and Pearson)."""
    tail = (1 - LEVEL) / 2
    low = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.isf(tail, hits + 1, of - hits)) if hits < of else 1.0
    return Rate(hits / of, low, high, of, float(hits), weighted=False)


def weighted(weights: Array) -> Rate:
    """Return the mean of weights (0 for runs without an alarm) with its normal interval."""
    w = np.asarray(weights, dtype=float)
    value, error = float(w.mean()), float(w.std() / np.sqrt(len(w)))
    return Rate(value, value - SURE * error, value + SURE * error, len(w), kish(w), weighted=True)


def kish(weights: Array) -> float:
    """Return the effective number of the weights that are not 0."""
    square = float(np.sum(weights**2))
    return float(np.sum(weights)) ** 2 / square if square > 0 else 0.0
