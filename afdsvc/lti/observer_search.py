"""Finding the observer hidden in a controller: which half of the loop's poles is state feedback, which is observer.

A controller of the plant's order n is an observer with state feedback F, observer gain L and a static Youla term Q.
With an n-dimensional invariant subspace [X1; X2] of the closed loop and ``T = X2 X1^-1``: ``F = Dk C + Ck T``,
``L = B Dk - T^-1 Bk``, ``Q = Dk``. Every half of the poles closed under conjugation is a candidate; the one whose T is
best conditioned is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb

import numpy as np
from scipy.linalg import schur

from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.statespace import Array, ComplexArray

CANDIDATES = 1000


def invariant_half(loop: Array, n: int) -> tuple[Array, float]:
    """Return T, shape ``(n, n)``, and its condition number (in balanced states) for the best half of the loop's poles.

    ``loop`` is the closed-loop matrix, plant states first, shape ``(2n, 2n)``. The condition number is inf when no half
    is closed under conjugation.
    """
    t = state_scaling(loop)
    scaled = loop * (t[None, :] / t[:, None])
    poles, vectors = np.linalg.eig(scaled)
    best: tuple[float, tuple[int, ...]] = (float("inf"), ())
    for half in _halves(poles, n):
        best = min(best, (_condition(vectors[:, half], n), half), key=lambda c: c[0])
    if not np.isfinite(best[0]):
        return np.zeros((n, n)), float("inf")
    return _transformation(scaled, poles[list(best[1])], n, t)


def _condition(X: ComplexArray, n: int) -> float:
    """Return the larger condition number of the two halves of a basis, the quantity T inherits."""
    Q = np.linalg.qr(X)[0]
    values = np.concatenate([np.linalg.svd(Q[:n], compute_uv=False), np.linalg.svd(Q[n:], compute_uv=False)])
    smallest = float(values.min())
    return 1 / smallest if smallest > 0 else float("inf")


def _transformation(scaled: Array, chosen: ComplexArray, n: int, t: Array) -> tuple[Array, float]:
    """Return T from an ordered Schur form, which stays accurate when eigenvectors are nearly parallel."""
    others_apart = 1e-6 * max(float(np.abs(chosen).max()), 1e-300)

    def picked(re: float, im: float) -> bool:
        return bool(np.abs(chosen - complex(re, im)).min() < others_apart)

    _, Z, k = schur(scaled, output="real", sort=picked)
    if k != n:
        return np.zeros((n, n)), float("inf")
    X1, X2 = Z[:n, :n], Z[n:, :n]
    condition = float(max(np.linalg.cond(X1), np.linalg.cond(X2)))
    if not condition < 1e14:
        return np.zeros((n, n)), float("inf")
    T = np.linalg.solve(X1.T, X2.T).T
    return T * (t[n:, None] / t[None, :n]), condition


def _halves(poles: ComplexArray, n: int) -> Iterator[tuple[int, ...]]:
    """Yield sets of n poles closed under conjugation: all if they are few, else neighbours in several orders."""
    groups = _conjugate_groups(poles)
    if comb(len(groups), len(groups) // 2) <= CANDIDATES:
        for count in range(1, len(groups) + 1):
            for some in combinations(groups, count):
                if sum(map(len, some)) == n:
                    yield tuple(i for g in some for i in g)
        return
    for key in (np.abs, np.real, np.imag, lambda s: np.abs(s - 1), lambda s: np.angle(s)):
        ordered = sorted(groups, key=lambda g: float(key(poles[g[0]])))
        for start in range(len(ordered)):
            yield from _fill(ordered[start:] + ordered[:start], n)


def _fill(groups: list[tuple[int, ...]], n: int) -> Iterator[tuple[int, ...]]:
    """Yield the first groups that together hold exactly n poles, skipping one that would overshoot."""
    chosen: list[int] = []
    for group in groups:
        if len(chosen) + len(group) <= n:
            chosen.extend(group)
    if len(chosen) == n:
        yield tuple(chosen)


def _conjugate_groups(poles: ComplexArray) -> list[tuple[int, ...]]:
    groups: list[tuple[int, ...]] = []
    i = 0
    while i < poles.size:
        pair = poles[i].imag != 0 and i + 1 < poles.size
        groups.append((i, i + 1) if pair else (i,))
        i += len(groups[-1])
    return groups
