"""Probability that any of several projections exceeds its threshold, averaged over the distribution of an uncertain model.

Every model q has a probability w_q, a mean and a covariance of z. With the tails ``P_qk = w_q P(<e_k, z> > h_k | q)`` the union is

    sum_qk P_qk E[1 / #{j: <z, e_j> > h_j} | q, <z, e_k> > h_k]

(R. M. Karp, M. Luby and N. Madras, *J. Algorithms* 10, 1989; R. J. Adler, J. H. Blanchet and J. Liu, *Ann. Appl. Probab.* 22,
2012), evaluated on a fixed low-discrepancy sequence whose points are spent on models and directions in proportion to their tails.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from afdsvc.detect.thresholds.maximum import points
from afdsvc.lti.statespace import Array

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
