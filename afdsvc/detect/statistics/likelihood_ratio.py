"""The likelihood ratio along fault curves: the grid of severities, and the threshold of the maximum.

On the curve of one fault the wave of severity theta is a vector t(theta) in standard deviations of the noise, and

    T = max_theta (<z, t> - |t|^2 / 2),   alarm when T > c

A wave t_k is exceeded where ``<z, e_k> > c / |t_k| + |t_k| / 2``: only waves about ``sqrt(2 c)`` long count, so a curve that
bends costs nothing where it is far out, and one fault is found nearly as well as if its severity were known. (The largest
projection of `maximum` looks for every direction of the curve at the same height.) A straight curve gives the matched
filter itself.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from afdsvc.detect.isolation import LineData
from afdsvc.detect.model_uncertainty import HealthyMachines
from afdsvc.detect.statistics.fault_curves import FaultCurves
from afdsvc.detect.thresholds.maximum import points, reduced
from afdsvc.lti.statespace import Array

SPACING = 0.25  # standard deviations between neighbours on a curve: costs at most 0.008 of T
GROWTH = 0.05  # spacing as a share of the length, where waves are long
FINE = 600  # severities among which those compared are chosen
SMALLEST = 1e-6  # smallest severity, as a share of the largest
SHORTEST = 1e-3  # standard deviations below which the whole curve of a fault counts as unseen


def waves_along(curves: FaultCurves, fault: str, data: LineData, end: float) -> Array:
    """Return whitened waves ``(T, D)`` on one curve from small severities to ``end``, as close as they can be distinguished.

    Empty when the burst cannot see the fault.
    """
    fine = curves.memo(lambda: curves.at(fault, end * np.geomspace(SMALLEST, 1.0, FINE)), "fine", fault, end)
    white = data.white_waves(data.R @ fine)
    length = np.linalg.norm(white, axis=1)
    if not length.max() > SHORTEST:
        return np.zeros((0, white.shape[1]))
    steps = np.linalg.norm(np.diff(white, axis=0), axis=1) / np.maximum(SPACING, GROWTH * length[1:])
    travelled = np.floor(np.cumsum(steps))
    chosen = 1 + np.flatnonzero(np.diff(travelled, prepend=0.0) > 0)
    return np.asarray(white[np.union1d(chosen, [FINE - 1])])


def statistic(waves: Array, z: Array) -> float:
    """Return ``max_k (<z, t_k> - |t_k|^2 / 2)``."""
    return float(np.max(waves @ z - 0.5 * np.sum(waves**2, axis=1)))


def threshold(waves: Array, false_alarm: float) -> float:
    """Return c with ``P(max_k (<z, t_k> - |t_k|^2 / 2) > c) = false_alarm`` for waves t_k of shape ``(K, D)``."""
    t = np.ascontiguousarray(waves, dtype=float)
    e, length = reduced(t), np.linalg.norm(t, axis=1)
    u, target = points(e.shape[1]), math.log(false_alarm)

    def excess(c: float) -> float:
        return math.log(max(_union(e, heights(length, c), u), 1e-300)) - target

    low, high = 1e-6, math.log(1 / false_alarm) + math.log(len(t)) + 1.0  # P <= K e^-c
    return low if excess(low) <= 0 else float(brentq(excess, low, high, xtol=1e-5))


def robust_threshold(waves: Array, factor: Array, found: HealthyMachines, false_alarm: float) -> float:
    """Return c at which the largest ratio exceeds c with probability ``false_alarm`` averaged over the models.

    ``factor`` is the Cholesky factor of the covariance the ``waves`` were whitened with.
    """
    t = np.ascontiguousarray(waves, dtype=float)
    length = np.linalg.norm(t, axis=1)
    e = np.linalg.solve(factor.T, (t / length[:, None]).T).T  # <e, z> is the whitened projection
    return found.mixture(e).threshold(lambda c: heights(length, c), false_alarm, threshold(t, false_alarm))


def heights(length: Array, c: float) -> Array:
    """Return what ``<z, e_k>`` must exceed for a wave of the given length to have a log likelihood ratio above c."""
    return np.asarray(c / length + length / 2)


def _union(e: Array, h: Array, u: Array) -> float:
    """Return the probability that any ``<z, e_k>`` exceeds its height ``h_k``.

    The union estimator of `maximum`, points ``u (N, 1 + D)`` being spent on the directions in proportion to their tails.
    """
    tails = ndtr(-h)
    total = float(tails.sum())
    if not total > 0:
        return 0.0
    k = np.minimum(np.searchsorted(np.cumsum(tails) / total, (np.arange(len(u)) + 0.5) / len(u)), len(e) - 1)
    w = ndtri(u[:, 1:])
    z = w + (-ndtri(u[:, 0] * tails[k]) - np.sum(w * e[k], axis=1))[:, None] * e[k]
    near = np.flatnonzero(tails > 1e-9 * tails.max())
    inverse = 1 / np.maximum((z @ e[near].T > h[near]).sum(axis=1), 1)
    return total * float(np.mean(inverse))
