"""The boundary of several CUSUMs that run always, from their average run lengths (`arl`).

CUSUMs whose increments resemble each other alarm together: each counts with its share of the union of alarms, so that the
promised rate is kept and not divided by the number of faults.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from afdsvc.detect import arl, maximum
from afdsvc.lti.statespace import Array

HERMITE = 15  # models averaged over in one direction


@dataclass(frozen=True, slots=True)
class Step:
    """Increments of one CUSUM under one model: deflection per look, bias of the mean, step at the ends of an excursion,
    weight in the sum."""

    mu: float
    bias: float
    step: float
    weight: float

    def rate(self, b: float) -> float:
        """Return alarms per look at a boundary, times the weight."""
        return self.weight / arl.run_length(self.mu, b, bias=self.bias, step=self.step)


def rate_boundary(correlation: Array, mu: Array, bias: Array, step: Array, per_look: float) -> float:
    """Return the boundary at which K CUSUMs that run always alarm ``per_look`` times per look in all.

    ``mu (K,)`` is the deflection per look of each, ``correlation (K, K)`` that of their log-likelihood ratios, ``bias (K,)``
    the standard deviation of their mean increments over uncertain models, ``step (K,)`` as in `arl.run_length`.
    """
    share = maximum.shares(_unit_vectors(correlation), math.sqrt(2 * math.log(1 / per_look)))
    steps = _steps(mu, bias, step, share)

    def excess(b: float) -> float:
        return math.log(sum(s.rate(b) for s in steps) / per_look)

    low, high = 0.05, math.log(len(mu) / per_look) + 1
    if excess(low) <= 0:
        return low
    while excess(high) > 0:  # biased increments may need a higher boundary than any unbiased ones
        high *= 1.5
    return float(brentq(excess, low, high, xtol=1e-4))


def _steps(mu: Array, bias: Array, step: Array, share: Array) -> list[Step]:
    """Return the distinct steps, to a per cent, and the shares that go with each; a normal bias by quadrature."""
    rounded = np.round(np.log(np.column_stack([mu, step])), 2)
    kinds, which = np.unique(np.column_stack([rounded, bias]), axis=0, return_inverse=True)
    weight = np.bincount(which.ravel(), weights=share)
    z, w = np.polynomial.hermite_e.hermegauss(HERMITE) if bias.any() else (np.zeros(1), np.ones(1))
    nodes = list(zip(z.tolist(), (w / w.sum()).tolist(), strict=True))
    kind = [(math.exp(m), d, math.exp(v), s) for (m, v, d), s in zip(kinds.tolist(), weight.tolist(), strict=True)]
    return [Step(m, d * zq, v, s * wq) for m, d, v, s in kind for zq, wq in nodes]


def _unit_vectors(gram: Array) -> Array:
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
