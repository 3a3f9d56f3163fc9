"""Whitening: an autoregressive model of the noise, so that every sum of squares is a likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

ORDER = 12


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """``w_k = L^-1 (e_k - sum_i a_i e_{k-i})``: coefficients ``a (order, p, p)``, ``L`` the Cholesky factor of the innovations.

    ``order`` 0 means that the noise is white already.
    """

    a: Array
    chol: Array

    @property
    def order(self) -> int:
        """How many past samples are used."""
        return len(self.a)

    @property
    def covariance(self) -> Array:
        """Covariance of the innovations, shape ``(p, p)``."""
        return self.chol @ self.chol.T

    def __call__(self, e: Array) -> Array:
        """Return the whitened residual, same shape ``(n, p)``; samples before the first count as zero."""
        w = e.copy()
        for i in range(self.order):
            w[i + 1 :] -= e[: -i - 1] @ self.a[i].T
        return np.asarray(w @ np.linalg.inv(self.chol).T)

    def scaled(self, variance: float) -> Whitener:
        """Return the same filter for noise of ``variance`` times the power."""
        return Whitener(self.a, self.chol * np.sqrt(variance))


def white(variance: Array) -> Whitener:
    """Return the whitener of white noise with this variance per channel, shape ``(p,)``, or covariance ``(p, p)``."""
    cov = np.diag(variance) if variance.ndim == 1 else variance
    return Whitener(np.zeros((0, *cov.shape)), _cholesky(cov))


def fit(pieces: Sequence[Array], order: int = ORDER) -> Whitener:
    """Return the whitener of noise seen in ``pieces`` (each ``(n, p)``), by least squares on ``order`` past samples."""
    p = pieces[0].shape[1]
    order = min(order, min(len(x) for x in pieces) // 4)
    gram, cross, total, count = np.zeros((order * p, order * p)), np.zeros((order * p, p)), np.zeros((p, p)), 0
    for x in pieces:
        past = np.hstack([x[order - i - 1 : len(x) - i - 1] for i in range(order)]) if order else np.zeros((len(x), 0))
        now = x[order:]
        gram += past.T @ past
        cross += past.T @ now
        total += now.T @ now
        count += len(now)
    if count <= order * p:
        raise BadInput(f"{count} samples of noise; expected more than {order * p} to whiten with order {order}")
    ridge = 1e-9 * np.trace(gram) / max(order * p, 1) * np.eye(order * p)
    coefficients = np.linalg.solve(gram + ridge, cross)
    cov = (total - coefficients.T @ cross) / count
    a = coefficients.T.reshape(p, order, p).transpose(1, 0, 2)
    return Whitener(a, _cholesky((cov + cov.T) / 2))


def _cholesky(cov: Array) -> Array:
    floor = 1e-12 * max(float(np.trace(cov)), 1e-300)
    return np.asarray(np.linalg.cholesky(cov + floor * np.eye(len(cov))))


def whiteness_p(pieces: Sequence[Array], lags: int = 20) -> float:
    """Return the p-value of the Ljung-Box test over all channels and both signs of cross-correlation, lags 1 to ``lags``."""
    n = sum(len(x) for x in pieces)
    p = pieces[0].shape[1]
    zero = sum((x.T @ x for x in pieces), np.zeros((p, p))) / n
    scale = np.sqrt(np.diag(zero))
    if not (scale > 0).all():
        return 1.0
    statistic = 0.0
    for lag in range(1, lags + 1):
        c = sum((x[lag:].T @ x[:-lag] for x in pieces if len(x) > lag), np.zeros((p, p))) / n
        rho = c / np.outer(scale, scale)
        statistic += n * (n + 2) / max(n - lag, 1) * float((rho**2).sum())
    return float(stats.chi2.sf(statistic, lags * p * p))


def unpredictable(pieces: Sequence[Array]) -> float:
    """Return the part of the power of residuals that their own past does not predict: 1 for white noise, averaged over channels."""
    power = np.mean([(x**2).mean(0) for x in pieces], axis=0)
    innovation = np.diag(fit(pieces).covariance)
    return float(np.clip(np.mean(innovation / np.maximum(power, 1e-300)), 0.0, 1.0))


def correlation_time(w: Array) -> float:
    """Return how many samples of a whitened residual ``(n, p)`` carry the information of one: 1 when it is white.

    Integrated autocorrelation of the squares' sign-free products, by Geyer's rule: summed until two neighbours turn negative.
    """
    total, p = 0.0, w.shape[1]
    for j in range(p):
        x = w[:, j] - w[:, j].mean()
        n = len(x)
        spectrum = np.abs(np.fft.rfft(x, 2 * n)) ** 2
        rho = np.fft.irfft(spectrum)[:n]
        rho = rho / max(rho[0], 1e-300)
        total += 1 + 2 * float((_initial_positive(rho[1 : n // 4]) ** 2).sum())
    return float(total / p)


def _initial_positive(rho: Array) -> Array:
    """Cut the autocorrelation where it has sunk into its own noise."""
    quiet = np.abs(rho) < 2 / np.sqrt(max(len(rho), 1) * 4)
    runs = np.convolve(quiet, np.ones(8), "valid") == 8
    stop = int(np.argmax(runs)) if runs.any() else len(rho)
    return rho[:stop]
