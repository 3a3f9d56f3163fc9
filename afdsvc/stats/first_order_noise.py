"""First-order noise beside white noise: the test that is the most powerful for it, over all correlation times.

For a small share ``s`` of the power with correlation ``a^k``, the likelihood rises fastest with ``sum_k rho_k a^k``; divided by
its standard deviation under white noise it is normal (the locally most powerful test). Over poles ``a = tanh(t)`` that statistic is
a Gaussian process with correlation ``1 / cosh(t - t')``, so the chance that its maximum passes ``z`` is bounded by the rate at which
a smooth process crosses a level: Davies (1977), Biometrika 64, equation 3.7, with unit second derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.lti.statespace import Array

FROM, TO, STEPS = 0.1, 3.0, 59  # range of t = atanh(pole): poles 0.1 to 0.995
LAGS = 600


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """How first-order noise shows: deviate ``z`` of the best ``pole``, ``share`` of the power that has it, and its standard deviation."""

    z: float
    pole: float
    share: float
    sd: float

    @property
    def p(self) -> float:
        """The chance that white noise shows a pole as clearly (upper bound)."""
        return min(float(stats.norm.sf(self.z) + (TO - FROM) / (2 * np.pi) * np.exp(-self.z**2 / 2)), 1.0)


def first_order(pieces: Sequence[Array], pole: float | None = None) -> FirstOrder:
    """Return how clearly noise ``pieces (n,)`` have a first-order part, at the pole where it is clearest or at a given one."""
    rho, n = autocorrelation(pieces)
    poles = np.tanh(np.linspace(FROM, TO, STEPS)) if pole is None else np.array([pole])
    shapes = poles[:, None] ** np.arange(1, len(rho) + 1)
    sizes = np.sqrt((shapes**2).sum(1))
    z = np.sqrt(n) * (shapes @ rho) / sizes
    best = int(np.argmax(z))
    share = float(z[best] / (np.sqrt(n) * sizes[best]))
    return FirstOrder(float(z[best]), float(poles[best]), share, _deviation(shapes[best] / sizes[best] ** 2, share * shapes[best], n))


def _deviation(weights: Array, correlation: Array, n: int) -> float:
    """Return the standard deviation of a weighted sum of ``n`` samples' correlations: the periodogram's, squared over frequency."""
    density, kernel = (np.fft.hfft(np.concatenate([[first], half])) for first, half in ((1.0, correlation), (0.0, weights / 2)))
    return float(np.sqrt(2 * np.mean((kernel * density) ** 2) / n))


def autocorrelation(pieces: Sequence[Array]) -> tuple[Array, int]:
    """Return the autocorrelation at lags 1 to `LAGS` (fewer for short pieces) and the number of samples it rests on."""
    lags = min(LAGS, min(len(x) for x in pieces) // 2)
    sums = np.zeros(lags + 1)
    for x in pieces:
        spectrum = np.fft.rfft(x - x.mean(), 2 * len(x))
        sums += np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return sums[1:] / max(float(sums[0]), 1e-300), sum(len(x) for x in pieces)
