"""CUSUM on log-likelihood ratios of many hypotheses at once, advanced block by block.

    g_h <- max(0, g_h + theta_h b_h - theta_h^2 G_h / 2),   alarm when max_h g_h > boundary

``b_h`` and ``G_h`` are score and information of the hypothesis over one block of samples. They follow from the products
of residual and features that all hypotheses share (`products`), so a sample costs the same however many there are; only
the end of a block looks at every hypothesis. A crossing is noticed at the end of its block: at most one block late.

A `DeflectionBoundary` moves the boundary of a hypothesis that gains more information than was expected (a reference moves).

For one hypothesis the test is exactly minimax: no other reacts sooner, in the worst case, at the same average run length
(G. V. Moustakides, *Ann. Statist.* 14, 1986).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from afdsvc.detect.burst_detector import BurstFinding
from afdsvc.detect.features.sums import Products, add_products
from afdsvc.detect.isolation import linear_fit, weights
from afdsvc.detect.thresholds.deflection_boundary import DeflectionBoundary, boundary_at
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class CusumState:
    """``g (H,)``, samples ``n (H,)`` and information ``gained (H,)`` since each g last was zero; the products of all blocks in one row, ``total (M,)``,
    and what they were when each g last was zero, ``began (H, M)``; the largest g so far; of the block that has begun:
    samples and products.
    """

    g: Array
    n: Array
    gained: Array
    total: Array
    began: Array
    peak: float
    begun: int
    cross: Array
    square: Array


@dataclass(frozen=True, slots=True, eq=False)
class Cusum:
    """Hypotheses ``theta (H, p, F)`` per unit of severity, their ``severity (H,)``; ``fitted (K,)`` are those whose
    severities are estimated; samples in a ``block``; ``boundary`` at the information expected, ``clock`` at more of it.

    ``at`` and ``quad`` hold theta and its products with the hypotheses along memory. Build one with `cusum`.
    """

    theta: Array
    severity: Array
    fitted: NDArray[np.intp]
    block: int
    boundary: float
    at: Array
    quad: Array
    clock: DeflectionBoundary

    def start(self) -> CusumState:
        """Return the state at rest."""
        H, p, F = self.theta.shape
        M = p * F + F * (F + 1) // 2
        return CusumState(
            np.zeros(H), np.zeros(H), np.zeros(H), np.zeros(M), np.zeros((H, M)), 0.0, 0, np.zeros((p, F)), np.zeros(M - p * F)
        )

    def step(self, state: CusumState, flat: Array) -> tuple[CusumState, int, int]:
        """Return the state, the sample at which the boundary was crossed (-1 if not) and by which hypothesis.

        ``flat (n, p + F)`` is the normalised residual, then the features. Stops at the crossing.
        """
        if flat.shape[1] != sum(state.cross.shape):
            raise BadInput(f"series of {flat.shape[1]} columns; expected {' and '.join(map(str, state.cross.shape))} of residual and features")
        g, n, gained, total, began = (a.copy() for a in (state.g, state.n, state.gained, state.total, state.began))
        cross, square = state.cross.copy(), state.square.copy()
        at, who, peak, begun = _cusum(
            np.ascontiguousarray(flat), self.at, self.quad, self.severity, self.block, self.boundary, *self.clock.arrays,
            state.peak, state.begun, g, n, gained, total, began, cross, square,
        )
        return CusumState(g, n, gained, total, began, peak, begun, cross, square), at, who

    def boundary_of(self, state: CusumState, who: int) -> float:
        """Return the boundary that hypothesis ``who`` has to cross."""
        c = self.clock
        return float(boundary_at(self.boundary, c.log_deflection, c.boundary, c.expected[who], state.gained[who], state.n[who] / self.block))

    def finding(
        self, state: CusumState, who: int, names: Sequence[str], bounds: tuple[float, float], sample: int
    ) -> BurstFinding:
        """Return a finding whose fits use the blocks since the CUSUM of hypothesis ``who`` last was zero.

        Such a stretch begins and ends where the data look faulty, so its severities are bounds, not estimates.
        """
        if not names:
            return BurstFinding(0.0, math.inf)
        b, G = self._segment(state, who)
        fits = tuple(linear_fit(n, float(v), float(i), bounds) for n, v, i in zip(names, b, G, strict=True))
        parts = {"sample": float(sample), "delay_samples": float(state.n[who])}
        crossed, boundary = float(state.g[who]), self.boundary_of(state, who)
        return BurstFinding(crossed if crossed > boundary else state.peak, boundary, fits, weights(fits), parts, early=True)

    def _segment(self, state: CusumState, who: int) -> tuple[Array, Array]:
        """Return score and information ``(K,)`` of the fitted hypotheses since g of ``who`` last was zero."""
        _, p, F = self.theta.shape
        since = state.total - state.began[who]
        products = Products(int(state.n[who]), since[: p * F].reshape(p, F), since[p * F :])
        theta = self.theta[self.fitted]
        return products.score(theta), np.diag(products.information(theta))


def cusum(
    theta: Array, severity: Array, fitted: Sequence[int], block: int, boundary: float, clock: DeflectionBoundary | None = None
) -> Cusum:
    """Return the CUSUMs of the hypotheses ``theta (H, p, F)`` at the given severities."""
    H, p, F = theta.shape
    i, j = np.triu_indices(F)
    twice = np.where(i == j, 1.0, 2.0)
    quad = np.einsum("hqj,hqj->jh", theta[:, :, i], theta[:, :, j]) * twice[:, None]
    at = np.ascontiguousarray(theta.reshape(H, p * F).T)
    return Cusum(theta, np.asarray(severity, dtype=float), np.array(fitted, dtype=np.intp), block, boundary, at, quad, clock or DeflectionBoundary.flat(H))


@njit(cache=True)
def _cusum(  # type: ignore[no-untyped-def]
    flat, at, quad, severity, block, boundary, deflection, table, expected, falls, peak, begun, g, n, gained, total, began, cross, square
):
    score, information, p = np.zeros(g.size), np.zeros(g.size), cross.shape[0]
    for t in range(flat.shape[0]):
        add_products(flat[t, :p], flat[t, p:], cross, square)
        begun += 1
        if begun < block:
            continue
        begun = 0
        _combined(at, cross.ravel(), score)
        _combined(quad, square, information)
        total[: cross.size] += cross.ravel()
        total[cross.size :] += square
        cross[:] = 0.0
        square[:] = 0.0
        _advanced(g, n, gained, total, began, severity, score, information, block)
        highest, margin = -1, -np.inf
        for h in range(g.size):
            peak = max(peak, g[h])
            if g[h] > boundary or gained[h] > falls[h] * n[h] / block:
                over = g[h] - boundary_at(boundary, deflection, table, expected[h], gained[h], n[h] / block)
                if over > margin:
                    highest, margin = h, over
        if margin > 0.0:
            return t, highest, peak, begun
    return -1, -1, peak, begun


@njit(cache=True)
def _combined(M, v, out):  # type: ignore[no-untyped-def]
    out[:] = 0.0
    for j in range(v.size):
        w = v[j]
        row = M[j]
        for h in range(out.size):
            out[h] += w * row[h]


@njit(cache=True)
def _advanced(g, n, gained, total, began, severity, score, information, block):  # type: ignore[no-untyped-def]
    """Advance every g by one block; those down to zero begin anew."""
    for h in range(g.size):
        g[h] += severity[h] * (score[h] - 0.5 * severity[h] * information[h])
        n[h] += block
        gained[h] += severity[h] ** 2 * information[h]
        if g[h] <= 0.0:
            g[h], n[h], gained[h] = 0.0, 0.0, 0.0
            began[h] = total
