"""Portmanteau tests of residuals: whiteness, and independence of the input.

Both are portmanteau tests. Under the hypothesis that nothing is left, the p-values are uniform; small ones name what
the model misses: not white - the noise model or a mode; correlated with past inputs - the plant; with future inputs -
feedback.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal, stats

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class ResidualTests:
    """Correlations of the residuals and what they say.

    ``autocorrelation (lags + 1, p)`` and ``crosscorrelation (2 lags + 1, p, m)`` (lag of u behind e, from ``-lags``)
    are normalised; ``band`` is the 95 % band of one white-noise autocorrelation, ``cross_band (p, m)`` that of one
    cross-correlation. ``p_white`` belongs to all autocorrelations together, ``p_independent (p, m)`` to lags 0 to
    ``lags``, ``p_feedback (p, m)`` to the negative lags.
    """

    lags: int
    autocorrelation: Array
    crosscorrelation: Array
    band: float
    cross_band: Array
    p_white: float
    p_independent: Array
    p_feedback: Array


def residual_tests(errors: Array, inputs: Array, lags: int = 25) -> ResidualTests:
    """Test residuals ``(N, p)`` against the inputs ``(N, m)``; raises `BadInput` when fewer than ``4 lags`` samples."""
    e, u = errors - errors.mean(axis=0), inputs - inputs.mean(axis=0)
    if len(e) < 4 * lags:
        raise BadInput(f"{len(e)} residuals for {lags} lags; expected at least {4 * lags}")
    p, m, count = e.shape[1], u.shape[1], len(e)
    auto = np.stack([_covariances(e[:, i], e[:, i], lags)[lags:] for i in range(p)], axis=1)
    cross = np.empty((2 * lags + 1, p, m))
    p_independent, p_feedback, cross_band = np.ones((p, m)), np.ones((p, m)), np.zeros((p, m))
    for i in range(p):
        for j in range(m):
            cross[:, i, j], cross_band[i, j], p_independent[i, j], p_feedback[i, j] = _cross(e[:, i], u[:, j], lags)
    scale = np.where(auto[0] > 0, auto[0], 1.0)
    return ResidualTests(
        lags,
        auto / scale,
        cross,
        1.96 / float(np.sqrt(count)),
        cross_band,
        portmanteau_test(e, lags),
        p_independent,
        p_feedback,
    )


def portmanteau_test(errors: Array, lags: int = 25, fitted: int = 0) -> float:
    """Return the p-value of Hosking's multivariate portmanteau test (J. Amer. Statist. Assoc. 75, 1980).

    ``Q = N^2 sum_k tr(C_k' C_0^-1 C_k C_0^-1) / (N - k)`` is chi-squared with ``p^2 lags - fitted`` degrees of freedom,
    ``fitted`` the number of noise parameters estimated from the same data.
    """
    e = errors - errors.mean(axis=0)
    count, p = e.shape
    covariance = e.T @ e / count
    if not np.linalg.eigvalsh(covariance)[0] > 0:
        return 1.0  # a noiseless output leaves nothing to test
    root = np.linalg.cholesky(covariance)
    z = linalg.solve_triangular(root, e.T, lower=True).T
    total = sum(((z[k:].T @ z[:-k] / count) ** 2).sum() / (count - k) for k in range(1, lags + 1))
    return float(stats.chi2.sf(count**2 * total, max(p * p * lags - fitted, 1)))


def _covariances(a: Array, b: Array, lags: int) -> Array:
    """Return ``sum_k a(k + tau) b(k) / N`` for tau from -lags to lags."""
    full = signal.correlate(a, b, mode="full", method="fft")
    middle = len(b) - 1
    return np.asarray(full[middle - lags : middle + lags + 1] / len(a))


def _cross(e: Array, u: Array, lags: int) -> tuple[Array, float, float, float]:
    """Return normalised cross-correlation, its 95 % band, and p-values of lags >= 0 and < 0.

    The covariance of the estimates for coloured signals is Bartlett's ``sum_k R_e(k) R_u(k + i - j) / N``.
    """
    count, reach = len(e), min(len(e) // 4, 20 * lags)
    Re, Ru = _covariances(e, e, reach), _covariances(u, u, reach)
    if not (Re[reach] > 0 and Ru[reach] > 0):
        return np.zeros(2 * lags + 1), 0.0, 1.0, 1.0
    cross = _covariances(e, u, lags)
    window = np.hanning(2 * reach + 3)[1:-1]  # tapers the noise of far lags
    spread = signal.correlate(Ru * window, Re * window, mode="full", method="fft")
    centre = len(spread) // 2
    toeplitz = linalg.toeplitz(spread[centre : centre + lags + 1]) / count
    scale = float(np.sqrt(Re[reach] * Ru[reach]))
    past, future = cross[lags:], cross[:lags]
    return (
        cross / scale,
        1.96 * float(np.sqrt(max(toeplitz[0, 0], 0.0))) / scale,
        _chi2(past, toeplitz),
        _chi2(future, toeplitz[:lags, :lags]),
    )


def _chi2(values: Array, covariance: Array) -> float:
    """Return the p-value of ``v' P^+ v``, over the directions the input has excited."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    keep = eigenvalues > 1e-6 * eigenvalues[-1]
    projected = vectors[:, keep].T @ values
    return float(stats.chi2.sf((projected**2 / eigenvalues[keep]).sum(), int(keep.sum())))
