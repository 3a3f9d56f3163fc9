"""Probability that the largest of several CUSUMs crosses a boundary within a burst, from the joint law of their increments.

Over block k the log-likelihood ratio of hypothesis h grows by ``<v_kh, z_k> - |v_kh|^2 / 2`` with z_k standard normal. An
alarm is made common by letting the wave of a hypothesis set in at a block, drawn at random, and weighted by the mean
likelihood ratio over all hypotheses and onsets, the sum over onsets by Shiryaev's recursion ``R <- (1 + R) exp(ratio)``.
At an alarm that mean is at least ``exp(boundary)`` over their number: the relative error does not grow as the alarm becomes
rare (importance sampling for rare change alarms: T. L. Lai and J. Z. Shan, *IEEE Trans. Autom. Control* 44, 1999). One set of
paths, on a fixed low-discrepancy sequence, serves every boundary. No run-length formula for one CUSUM, no share of every
CUSUM in the union and no allowance for uneven increments is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtri
from scipy.stats import qmc

from afdsvc.lti.statespace import Array

PATHS = 1 << 13  # about one per cent of the probability

LARGE = 1e150  # a likelihood ratio beyond which a path weighs nothing


@dataclass(frozen=True, slots=True, eq=False)
class CrossingPaths:
    """Highest CUSUM up to the end of every block and the weight of an alarm there, both ``(N, blocks)``."""

    highest: Array
    weight: Array

    def probability(self, boundary: float) -> float:
        """Return the probability of an alarm."""
        first = np.sum(self.highest <= boundary, axis=1)  # the highest never falls
        crossed = np.flatnonzero(first < self.highest.shape[1])
        return float(np.sum(self.weight[crossed, first[crossed]]) / len(self.highest))

    def boundary(self, false_alarm: float) -> float:
        """Return the boundary that is crossed with probability ``false_alarm``."""
        low, high = 0.0, float(self.highest.max()) + 1.0

        def excess(b: float) -> float:
            return math.log(max(self.probability(b), 1e-300) / false_alarm)

        return low if excess(low) <= 0 else float(brentq(excess, low, high, xtol=1e-5))


@dataclass(frozen=True, slots=True, eq=False)
class CrossingNoise:
    """What z_k is without a fault, in Q models of weights ``(Q,)``: ``mean (Q, blocks, D)``, ``root (Q, D, D)`` times a
    standard normal."""

    weights: Array
    mean: Array
    root: Array


def paths(waves: Array, noise: CrossingNoise | None = None) -> CrossingPaths:
    """Return paths of the CUSUMs of the hypotheses ``waves (blocks, H, D)``, spread over the models of the noise."""
    blocks, H, D = waves.shape
    u = np.clip(qmc.Sobol(2 + blocks * D, scramble=True, seed=1).random(PATHS), 1e-12, 1 - 1e-12)
    pushed, w = (u[:, 0] * (H * blocks)).astype(np.intp), ndtri(u[:, 2:]).reshape(PATHS, blocks, D)
    if noise is None:
        return _paths(waves, waves, w, w, pushed)
    Q = len(noise.weights)
    model = (u[:, 1] * Q).astype(np.intp)
    highest, weight = np.empty((PATHS, blocks)), np.empty((PATHS, blocks))
    for q in range(Q):
        own = np.flatnonzero(model == q)
        pulled = np.linalg.solve(noise.root[q], np.swapaxes(waves, 1, 2)).swapaxes(1, 2)
        found = _paths(waves, pulled, w[own] @ noise.root[q].T + noise.mean[q], w[own], pushed[own])
        highest[own], weight[own] = found.highest, found.weight * noise.weights[q] * PATHS / len(own)
    return CrossingPaths(highest, weight)


def _paths(waves: Array, pulled: Array, z: Array, w: Array, pushed: NDArray[np.intp]) -> CrossingPaths:
    """Return paths for noise ``w (N, blocks, D)`` seen as ``z``; ``pulled`` are the waves in the coordinates of w."""
    N, blocks, _ = w.shape
    H = waves.shape[1]
    who, onset = pushed % H, pushed // H
    g, shiryaev, top = np.zeros((N, H)), np.zeros((N, H)), np.zeros(N)
    highest, weight = np.empty((N, blocks)), np.empty((N, blocks))
    for k in range(blocks):
        on = (onset <= k)[:, None]
        seen, own = z[:, k] + on * waves[k, who], w[:, k] + on * pulled[k, who]
        g = np.maximum(g + seen @ waves[k].T - 0.5 * np.sum(waves[k] ** 2, axis=1), 0.0)
        ratio = own @ pulled[k].T - 0.5 * np.sum(pulled[k] ** 2, axis=1)
        shiryaev = np.minimum((1 + shiryaev) * np.exp(np.minimum(ratio, 300.0)), LARGE)
        top = np.maximum(top, g.max(axis=1))
        highest[:, k] = top
        weight[:, k] = blocks * H / (shiryaev.sum(axis=1) + H * (blocks - 1 - k))
    return CrossingPaths(highest, weight)
