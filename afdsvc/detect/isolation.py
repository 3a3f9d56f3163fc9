"""Isolation: from log likelihoods to weights and severities of the faults, with the hypothesis "none of these".

Every fault is fitted by itself; severities have a uniform prior over their range, and a fault's evidence is the
likelihood averaged over that prior. ``none_of_these`` is the hypothesis that an arbitrary wave came back: its
coordinates are independent normals whose variance is the one that suits the data best (empirical Bayes), so it wins
only when no curve comes near.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr, logsumexp

from afdsvc.detect.statistics.fault_curves import FaultCurves
from afdsvc.lti.statespace import Array

NONE = "none_of_these"
HUGE = 1e150  # score whose square would overflow: that of a loop that is lost
NARROW = 2e-8  # of a range of severities: difference of log probabilities of its ends below which rounding is the larger error


@dataclass(frozen=True, slots=True)
class Fit:
    """One fault fitted: severity inside its range, standard error (inf when the burst cannot see the fault),
    log likelihood ratio against "no fault" and the same averaged over the severities.

    ``limit`` is the severity from which on, all else equal, nothing would have been detected; inf where detection does not depend on it.
    ``bias`` bounds the error of a linearisation, which ``sd`` includes.
    """

    fault: str
    severity: float
    sd: float
    log_likelihood: float
    log_evidence: float
    limit: float = math.inf
    bias: float = 0.0


def linear_fit(fault: str, score: float, information: float, bounds: tuple[float, float]) -> Fit:
    """Return the fit of ``loglik(theta) = score theta - information theta^2 / 2`` with theta inside its bounds."""
    low, high = bounds
    if not information > 0:
        return Fit(fault, min(max(0.0, low), high), math.inf, 0.0, 0.0)
    free, sd = score / information, information**-0.5
    theta = min(max(free, low), high)
    likelihood = score * theta - 0.5 * information * theta**2
    peak = 0.5 * score**2 / information if abs(score) < HUGE else 0.5 * score * free
    inside = _log_interval((low - free) / sd, (high - free) / sd)
    evidence = likelihood if inside is None else peak + inside + math.log(sd * math.sqrt(2 * math.pi) / (high - low))
    return Fit(fault, theta, sd, likelihood, evidence)


@dataclass(frozen=True, slots=True, eq=False)
class LineData:
    """Excited lines in standardised coordinates: ``z (2 L, p)`` and ``R (2 L, 2 L)`` as in `demodulate.Lines`.

    ``doubt (D, D)`` is what an uncertain model adds to the covariance of z; zero for a model that is certain.
    """

    z: Array
    R: Array
    doubt: Array

    def whitened(self, covariance: Array, *values: Array) -> list[Array]:
        """Return arrays shaped like z as vectors in which the covariance plus doubt is the identity."""
        factor = np.linalg.cholesky(covariance + self.doubt)
        return [np.asarray(solve_triangular(factor, v.ravel(), lower=True)) for v in values]


    def white_waves(self, waves: Array) -> Array:
        """Return healthy-machine waves ``(T, 2 L, p)`` as vectors ``(T, D)`` in which noise and doubt are the identity."""
        flat = waves.reshape(len(waves), -1)
        if not self.doubt.any():
            return flat
        factor = np.linalg.cholesky(np.eye(flat.shape[1]) + self.doubt)
        return np.asarray(solve_triangular(factor, flat.T, lower=True).T)


def curve_fit(
    curves: FaultCurves, fault: str, data: LineData, bounds: tuple[float, float], points: int = 33
) -> Fit:
    """Return the likeliest point of a fault's curve.

    A grid finds the neighbourhood, Gauss-Newton the point. Distances are measured in the noise the faulty loop makes,
    which is not that of the healthy one; its dependence on the severity is left out of the derivatives only. The
    standard error is that of the linearisation.
    """
    low, high = bounds
    grid = np.linspace(low, high, points)
    theta = float(grid[int(np.argmax(_log_likelihoods(curves, fault, grid, data)))])
    for _ in range(20):
        rest, tangent = _linearised(curves, fault, theta, data)
        moved = min(max(theta + _newton(rest, tangent), low), high)
        if abs(moved - theta) < 1e-12:
            break
        theta = moved
    rest, tangent = _linearised(curves, fault, theta, data)
    information = float(tangent @ tangent)
    if not information > 1e-12:
        return Fit(fault, theta, math.inf, 0.0, 0.0)
    gain = float(_log_likelihoods(curves, fault, np.array([theta]), data)[0])
    around = linear_fit(fault, float(rest @ tangent), information, (low - theta, high - theta))
    return Fit(fault, theta, around.sd, gain, gain + around.log_evidence)


def _log_likelihoods(curves: FaultCurves, fault: str, severities: Array, data: LineData) -> Array:
    """Return log likelihood ratios against the healthy machine, one for each severity."""
    return _gains(data, *curves.coloured(fault, severities))


def likelihood_gain(data: LineData, point: Array, covariance: Array) -> float:
    """Return the log likelihood ratio of one wave ``(2 L, p)`` with noise of a covariance ``(D, D)`` against the healthy machine."""
    return float(_gains(data, point[None], covariance[None])[0])


def _gains(data: LineData, points: Array, covariances: Array) -> Array:
    left = data.z - data.R @ points
    return _log_density(left.reshape(len(left), -1), covariances + data.doubt) - _log_density(
        data.z.reshape(1, -1), np.eye(data.z.size)[None] + data.doubt
    )


def _log_density(z: Array, covariance: Array) -> Array:
    """Return log densities of vectors ``(T, D)`` with covariances ``(T, D, D)``, up to a constant."""
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, z[:, :, None])
    logdet = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
    return np.asarray(-0.5 * np.sum(white**2, axis=(1, 2)) - logdet)


def _linearised(curves: FaultCurves, fault: str, theta: float, data: LineData) -> tuple[Array, Array]:
    """Return what a point of the curve leaves of z, and the curve's tangent there, both whitened."""
    points, covariances = curves.coloured(fault, [theta])
    rest, tangent = data.whitened(covariances[0], data.z - data.R @ points[0], data.R @ curves.slope(fault, theta))
    return rest, tangent


def limited(fit: Fit, excess: Array, slope: Array) -> Fit:
    """Return the fit with its limit: ``excess (K,)`` is by how much each comparison exceeds its threshold, ``slope (K,)`` its derivative by
    the severity."""
    above = excess > 0
    if not (math.isfinite(fit.sd) and above.any()):
        return fit
    if (slope[above] >= 0).any():
        return replace(fit, limit=math.inf)
    return replace(fit, limit=fit.severity + float(np.max(excess[above] / -slope[above])))


def weights(
    fits: Sequence[Fit], none_log_evidence: float | None = None, none_prior: float = 0.05
) -> Mapping[str, float]:
    """Return posterior weights of the faults, equally likely beforehand, and of `NONE` when its evidence is given."""
    names = [f.fault for f in fits]
    logs = [f.log_evidence for f in fits]
    if none_log_evidence is not None:
        names.append(NONE)
        logs.append(none_log_evidence + math.log(none_prior * max(len(fits), 1)))
    total = logsumexp(logs)
    return {n: float(np.exp(v - total)) for n, v in zip(names, logs, strict=True)}


def anything_log_evidence(z: Array) -> float:
    """Return the log evidence ratio of "an arbitrary wave" against "noise only" for standardised coordinates z."""
    energy, D = float(np.sum(z**2)), z.size
    variance = max(energy / D - 1, 0.0)
    return 0.5 * (energy * variance / (1 + variance) - D * math.log1p(variance))


def _newton(rest: Array, tangent: Array) -> float:
    information = float(np.sum(tangent**2))
    return float(np.sum(rest * tangent)) / information if information > 0 else 0.0


def _log_interval(a: float, b: float) -> float | None:
    """Return ``log(Phi(b) - Phi(a))`` without cancellation in the tails, a <= b; None where the density is the same all over."""
    if a > 0:
        a, b = -b, -a
    upper, lower = float(log_ndtr(b)), float(log_ndtr(a))
    return upper + math.log(-math.expm1(lower - upper)) if upper - lower > NARROW * math.sqrt(1 - upper) else None
