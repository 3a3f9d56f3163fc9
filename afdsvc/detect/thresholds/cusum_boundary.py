"""The boundary of several CUSUMs running between bursts, from their average run lengths.

CUSUMs whose increments resemble each other alarm together: each counts with its share of the union of alarms, so that the
promised rate is kept and not divided by the number of faults. Shares at one height and run lengths of uneven steps are
approximate; their sum is multiplied by what the joint law of the CUSUMs (`joint_rate`) finds it wrong by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from afdsvc.detect.thresholds import average_run_length, maximum
from afdsvc.detect.thresholds.joint_false_alarm_rate import JointRate
from afdsvc.lti.statespace import Array

HERMITE = 15  # models averaged over in one direction
LOWEST = 0.05  # boundary
AROUND = np.linspace(-0.8, 0.8, 9)  # boundaries simulated, about the one looked for


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
        return self.weight / average_run_length.run_length(self.mu, b, bias=self.bias, step=self.step)


def rate_boundary(
    correlation: Array, mu: Array, bias: Array, step: Array, per_look: float, joint: JointRate | None = None
) -> float:
    """Return the boundary at which K CUSUMs that run always alarm ``per_look`` times per look in all.

    ``mu (K,)`` is the deflection per look of each, ``correlation (K, K)`` that of their log-likelihood ratios, ``bias (K,)``
    the standard deviation of their mean increments over uncertain models, ``step (K,)`` as in `arl.run_length`. ``joint``
    simulates all of them or some, without bias: what it finds relative to the formula for the same CUSUMs corrects the sum.
    """
    height = math.sqrt(2 * math.log(1 / per_look))
    steps = _steps(mu, bias, step, maximum.shares(_unit_vectors(correlation), height))
    found = _solved(steps, per_look, len(mu))
    if joint is None or found <= LOWEST:
        return found
    own = joint.which
    same = _steps(mu[own], 0 * bias[own], step[own], maximum.shares(_unit_vectors(correlation[np.ix_(own, own)]), height))
    for _ in range(3):  # again about the boundary found, until that is one of those simulated
        grid = np.maximum(found + AROUND, LOWEST + 0.01 * np.arange(len(AROUND)))
        simulated = joint.per_look(grid, per_look)
        if simulated is None:
            return found
        correction = np.log(np.maximum(simulated, 1e-300)) - [math.log(_rate(same, b)) for b in grid.tolist()]
        found = _solved(steps, per_look, len(mu), grid, correction)
        if grid[0] <= found <= grid[-1]:
            break
    return found


def _rate(steps: list[Step], b: float) -> float:
    return sum(s.rate(b) for s in steps)


def _solved(steps: list[Step], per_look: float, K: int, grid: Array | None = None, correction: Array | None = None) -> float:
    """Return the boundary kept by the sum of the steps, times the exponential of the correction interpolated on the grid."""

    def excess(b: float) -> float:
        log_rate = math.log(_rate(steps, b) / per_look)
        return log_rate if grid is None or correction is None else log_rate + float(np.interp(b, grid, correction))

    low, high = LOWEST, math.log(K / per_look) + 1
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
