"""Thresholds for the largest of several matched filters.

A detector that looks for K waves at once computes ``T = max_k <z, e_k>`` of a standard normal vector z and unit vectors
e_k. Its false-alarm probability lies between ``Q(h)`` and ``K Q(h)`` and is found here exactly:

* all e_k on one line: ``Q(h)`` or ``2 Q(h)``;
* in one plane (one frequency, one output): the integral over the angle of
  ``exp(-(h / max_k cos(psi - phi_k))^2 / 2) / 2 pi``;
* otherwise the union estimator ``sum_k Q(h) E[1 / #{j: <z, e_j> > h} | <z, e_k> > h]`` (R. M. Karp, M. Luby and
  N. Madras, *J. Algorithms* 10, 1989; R. J. Adler, J. H. Blanchet and J. Liu, *Ann. Appl. Probab.* 22, 2012) on a fixed
  low-discrepancy sequence: its relative error does not grow as the alarm becomes rare.

Averaged over the distribution of an uncertain model (`Mixture`) every model q has a probability w_q, a mean and a covariance of z. With
the tails ``P_qk = w_q P(<e_k, z> > h_k | q)`` the union is ``sum_qk P_qk E[1 / #{j: <z, e_j> > h_j} | q, <z, e_k> > h_k]``, its points
spent on models and directions in proportion to their tails.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from afdsvc.detect.thresholds.power import tail, tail_point
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

POINTS = 1 << 13  # of the low-discrepancy sequence: one per cent of the probability, two per mille of the threshold
ANGLES = 1 << 14
_SAME = 1e-9  # singular values below this share of the largest are rounding


def exceedance(directions: Array, h: float) -> float:
    """Return ``P(max_k <z, e_k> > h)`` for ``directions`` of shape ``(K, D)`` (any lengths above 0) and ``h >= 0``."""
    e = reduced(directions)
    return _exceedance(e, points(e.shape[1]), h)


def maximum_threshold(directions: Array, false_alarm: float) -> float:
    """Return h with ``P(max_k <z, e_k> > h) = false_alarm``; raises `BadInput` for a zero direction.

    ``false_alarm`` must leave h non-negative.
    """
    e = np.ascontiguousarray(reduced(directions))
    u = points(e.shape[1])
    low, high = max(tail_point(false_alarm), 0.0), max(tail_point(false_alarm / (2 * len(e))), 0.1)
    target = math.log(false_alarm)
    if math.log(_exceedance(e, u, low)) <= target:  # the estimator's own rounding
        return low
    return float(brentq(lambda h: math.log(_exceedance(e, u, h)) - target, low, high, xtol=1e-6))


def tests_counted(directions: Array, h: float) -> float:
    """Return ``P(max_k <z, e_k> > h) / Q(h)``: how many independent tests the set is worth, between 1 and K."""
    return exceedance(directions, h) / tail(h)


def shares(directions: Array, h: float) -> Array:
    """Return ``E[1 / number of exceedances | <z, e_k> > h]`` for every k, shape ``(K,)``: the part each adds to the
    union.
    """
    e = reduced(directions)
    u = points(e.shape[1])
    return np.array([_share(e, k, u, h) for k in range(len(e))])


def _exceedance(e: Array, u: Array, h: float) -> float:
    if e.shape[1] == 1:
        return tail(h) * len(set(np.sign(e[:, 0])))
    if e.shape[1] == 2:
        return _in_a_plane(e, h)
    return tail(h) * float(np.sum(_union_terms(e, u, h)))


def _in_a_plane(e: Array, h: float) -> float:
    psi = np.arange(ANGLES) * (2 * np.pi / ANGLES)
    nearest = np.max(np.cos(psi[:, None] - np.arctan2(e[:, 1], e[:, 0])[None, :]), axis=1)
    with np.errstate(divide="ignore", over="ignore"):
        values = np.where(nearest > 0, np.exp(-0.5 * (h / np.where(nearest > 0, nearest, 1.0)) ** 2), 0.0)
    return float(np.mean(values))


def _union_terms(e: Array, u: Array, h: float) -> Array:
    """Return the mean of 1/count for every direction, one term per point; neighbouring points belong to one direction,
    since every stretch of a low-discrepancy sequence is spread evenly while every K-th point may not be.
    """
    K = len(e)
    k = np.arange(len(u)) * K // len(u)
    return np.asarray(1 / np.bincount(k, minlength=K)[k] / _counts(e, k, u, h))


def _share(e: Array, k: int, u: Array, h: float) -> float:
    return float(np.mean(1 / _counts(e, np.full(len(u), k), u, h)))


def _counts(e: Array, k: NDArray[np.intp], u: Array, h: float) -> Array:
    """Return how many directions exceed h at points drawn with direction ``k`` above h, shape as ``k``."""
    t = -ndtri(u[:, 0] * ndtr(-h))  # the component along e_k, given that it exceeds h
    w = ndtri(u[:, 1:])
    along = np.sum(w * e[k], axis=1)
    z = w + (t - along)[:, None] * e[k]
    above = (z @ e.T > h).sum(axis=1)
    return np.array(np.maximum(above, 1), dtype=np.float64)  # rounding may put the drawn one a hair below h


def points(dimension: int) -> Array:
    """Return Sobol points in (0, 1), shape ``(POINTS, 1 + dimension)``, shifted off the edges of the cube."""
    sobol = qmc.Sobol(1 + dimension, scramble=False).random(POINTS)
    shift = np.modf((1 + np.arange(1 + dimension)) * 0.6180339887498949)[0]
    return np.array(np.clip(np.modf(sobol + shift)[0], 1e-12, 1 - 1e-12), dtype=np.float64)


def reduced(directions: Array) -> Array:
    """Return unit vectors expressed in the subspace they span; equal directions are kept once."""
    e = np.atleast_2d(np.asarray(directions, dtype=float))
    lengths = np.linalg.norm(e, axis=1)
    if e.size == 0 or not np.isfinite(lengths).all() or (lengths == 0).any():
        raise BadInput(f"directions of lengths {np.round(lengths, 6).tolist()}; expected at least one direction, none of length 0")
    e = e / lengths[:, None]
    _, s, vt = np.linalg.svd(e, full_matrices=False)
    return np.asarray(e @ vt[s > _SAME * s[0]].T)


_NEAR = 1e-9  # tails below this share of the largest never decide


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Models of weights ``(Q,)``, means ``(Q, D)`` and roots ``(Q, D, D)`` of the covariance of z, seen along ``directions (K, D)``."""

    weights: Array
    means: Array
    roots: Array
    directions: Array
    points: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", points(self.directions.shape[1]))

    def exceedance(self, heights: Array) -> float:
        """Return the probability that any ``<z, e_k>`` exceeds its height, ``heights (K,)``."""
        e = self.directions
        mean = self.means @ e.T
        along = np.einsum("kd,qdc->qkc", e, self.roots)
        sd = np.maximum(np.linalg.norm(along, axis=2), 1e-12)
        tails = ndtr((mean - heights) / sd)
        share = (self.weights[:, None] * tails).ravel()
        total = float(share.sum())
        if not total > 0:
            return 0.0
        u = self.points
        picked = np.searchsorted(np.cumsum(share) / total, (np.arange(len(u)) + 0.5) / len(u))
        q, k = np.divmod(np.minimum(picked, len(share) - 1), len(e))
        w, axis = ndtri(u[:, 1:]), along[q, k] / sd[q, k, None]
        w += (-ndtri(u[:, 0] * tails[q, k]) - np.sum(w * axis, axis=1))[:, None] * axis
        z = self.means[q] + np.einsum("ndc,nc->nd", self.roots[q], w)
        near = np.flatnonzero(tails.max(axis=0) > _NEAR * tails.max())
        return total * float(np.mean(1 / np.maximum((z @ e[near].T > heights[near]).sum(axis=1), 1)))

    def threshold(self, heights: Callable[[float], Array], false_alarm: float, start: float) -> float:
        """Return c with ``exceedance(heights(c)) = false_alarm``; heights grow with c, ``start`` is a guess, the least is 1e-6."""
        least, high = 1e-6, start

        def excess(c: float) -> float:
            return math.log(max(self.exceedance(heights(c)), 1e-300) / false_alarm)

        while excess(high) > 0:
            high *= 1.5
        return float(brentq(excess, least, high, xtol=1e-5)) if excess(least) > 0 else least
