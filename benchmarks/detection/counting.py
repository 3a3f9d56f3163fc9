"""From scores to probabilities: thresholds from healthy scores, detection probabilities with intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, binomtest

from afdsvc.lti.statespace import Array

DRAWS = 400


@dataclass(frozen=True)
class Share:
    """A probability with its 95 per cent interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})"


def share(hits: int, of: int, level: float = 0.95) -> Share:
    """Return a binomial share with its Jeffreys interval."""
    low, high = beta.ppf([(1 - level) / 2, (1 + level) / 2], hits + 0.5, of - hits + 0.5)
    return Share(hits / of, 0.0 if hits == 0 else float(low), 1.0 if hits == of else float(high))


def exact(hits: int, of: int, level: float = 0.95) -> Share:
    """Return a binomial share with the interval of Clopper and Pearson."""
    found = binomtest(hits, of).proportion_ci(level, "exact")
    return Share(hits / of, float(found.low), float(found.high))


def power(healthy: Array, faulty: Array, rate: float, seed: int = 1) -> Share:
    """Return the probability that a faulty score exceeds the threshold that healthy scores exceed at ``rate``.

    The interval counts both errors: the threshold's (order statistics of the healthy scores are beta distributed) and the
    binomial one of the faulty scores.
    """
    ordered, scores = np.sort(healthy), np.sort(faulty)
    n, m, k = len(ordered), len(scores), max(round(rate * len(ordered)), 1)
    value = 1 - np.searchsorted(scores, ordered[n - k], side="right") / m if rate * n >= 1 else np.nan
    rng = np.random.default_rng(seed)
    above = rng.beta(k, n + 1 - k, DRAWS)  # true rates the k-th largest score may stand for
    rank = np.clip(np.round(rate / above * k).astype(int), 1, n)
    hits = m - np.searchsorted(scores, ordered[n - rank], side="right")
    draws = rng.beta(hits + 0.5, m - hits + 0.5)
    low, high = np.quantile(draws, [0.025, 0.975])
    return Share(float(value), min(float(low), float(value)), max(float(high), float(value)))


def roc(healthy: Array, faulty: Array, rates: Array) -> list[Share]:
    """Return the powers at several alarm rates."""
    return [power(healthy, faulty, float(rate)) for rate in rates]
