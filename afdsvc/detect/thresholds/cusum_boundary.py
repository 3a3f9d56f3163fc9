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

LOWEST = 0.05  # boundary
AROUND = np.linspace(-0.8, 0.8, 5)  # boundaries simulated, about the one looked for


@dataclass(frozen=True, slots=True, eq=False)
class Models:
    """Models that may be true, Q for each of K CUSUMs, arrays ``(K, Q)``: deflection per look, bias of the mean increment, weight."""

    mu: Array
    bias: Array
    weight: Array


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
    correlation: Array, mu: Array, step: Array, per_look: float, joint: JointRate | None = None, models: Models | None = None
) -> float:
    """Return the boundary at which K CUSUMs that run always alarm ``per_look`` times per look in all.

    ``mu (K,)`` is the deflection per look of each, ``correlation (K, K)`` that of their log-likelihood ratios, ``step (K,)`` as in
    `arl.run_length`; ``models`` are averaged over. ``joint`` simulates all of them or some, in the nominal model: what it finds relative
    to the formula for the same CUSUMs corrects the sum.
    """
    height = math.sqrt(2 * math.log(1 / per_look))
    steps = _steps(mu, step, maximum.shares(_unit_vectors(correlation), height), models)
    found = _solved(steps, per_look, len(mu))
    if joint is None or found <= LOWEST:
        return found
    own = joint.which
    same = _steps(mu[own], step[own], maximum.shares(_unit_vectors(correlation[np.ix_(own, own)]), height))
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


def _steps(mu: Array, step: Array, share: Array, models: Models | None = None) -> list[Step]:
    """Return the distinct steps, to a per cent, and the shares that go with each."""
    m = models or Models(mu[:, None], np.zeros((len(mu), 1)), np.ones((len(mu), 1)))
    rounded = np.round(np.log(np.column_stack([m.mu, step])), 2)
    kinds, which = np.unique(np.column_stack([rounded, m.bias, m.weight]), axis=0, return_inverse=True)
    shares, Q, steps = np.bincount(which.ravel(), weights=share).tolist(), m.mu.shape[1], list[Step]()
    for kind, share_of_kind in zip(kinds.tolist(), shares, strict=True):
        each = zip(kind[:Q], kind[Q + 1 : 2 * Q + 1], kind[2 * Q + 1 :], strict=True)
        steps += [Step(math.exp(log_mu), bias, math.exp(kind[Q]), share_of_kind * weight) for log_mu, bias, weight in each if weight > 0]
    return steps


def _unit_vectors(gram: Array) -> Array:
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
