"""Rare alarms of the CUSUM during bursts on machines with parameters drawn: only the coordinates of its blocks are drawn.

Mean and covariance of every block follow from the machine's own response at the lines, as for `drawn_lines`. Runs are pushed by a
hypothesis that sets in at a random block, in the noise's own coordinates, and weighted by all there might have been.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drawn_cases import Doubtful
from drawn_lines import wider
from numba import njit
from rates_counting import Rate, weighted
from rates_sequential import cusum_blocks

from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.lti.statespace import Array


def cusum_drawn(doubtful: Doubtful, rates: tuple[float, ...], machines: int, each: int, seed: int) -> dict[float, list[Rate]]:
    """Return the rates with the model doubtful and taken as certain, at every promised rate."""
    case = doubtful.case
    lines = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
    truth = replace(case.problem, augmented=doubtful.together, uncertain=None, uncertainty={}, severity_range=(-1.0, 1.0))
    curves, rng = fault_curves(truth, lines), np.random.default_rng([seed, 13])
    found = {(rate, k): cusum_blocks(c, rate) for rate in rates for k, c in enumerate((case, doubtful.certain))}
    weights = {side: np.zeros(machines) for side in found}
    for i in range(machines):
        z, log_prior = wider(rng, len(doubtful.deviations))
        drawn = {name: float(sd * v) for (name, sd), v in zip(doubtful.deviations.items(), z, strict=True)}
        point, covariance = curves.together(drawn)
        root = np.linalg.cholesky(covariance)
        for side, test in found.items():
            mean = np.ascontiguousarray((test.roots @ point).reshape(len(test.roots), -1))
            pulled = np.ascontiguousarray(np.linalg.solve(root, np.swapaxes(test.waves, 1, 2)).swapaxes(1, 2))
            weights[side][i] = np.exp(log_prior) * np.mean(
                [_run(rng, test.waves, pulled, mean, root, test.boundary) for _ in range(each)]
            )
    return {rate: [weighted(weights[rate, k]) for k in range(2)] for rate in rates}


def _run(rng: np.random.Generator, waves: Array, pulled: Array, mean: Array, root: Array, boundary: float) -> float:
    n, H, D = waves.shape
    w, who, onset = rng.normal(size=(n, D)), int(rng.integers(H)), int(rng.integers(n))
    w[onset:] += pulled[onset:, who]
    return float(_weight(mean + w @ root.T, w, waves, pulled, boundary))


@njit(cache=True)
def _weight(z, w, waves, pulled, boundary):  # type: ignore[no-untyped-def]
    """Return the weight of the first crossing, 0 without one: g sees z, the likelihood ratios are those of w."""
    n, H, D = waves.shape
    g, shiryaev = np.zeros(H), np.zeros(H)
    for t in range(n):
        for h in range(H):
            seen = own = 0.0
            for d in range(D):
                seen += waves[t, h, d] * z[t, d] - 0.5 * waves[t, h, d] ** 2
                own += pulled[t, h, d] * w[t, d] - 0.5 * pulled[t, h, d] ** 2
            g[h] = max(g[h] + seen, 0.0)
            shiryaev[h] = (1.0 + shiryaev[h]) * np.exp(own)
        if g.max() > boundary:
            return n / (shiryaev.sum() / H + n - 1 - t)
    return 0.0
