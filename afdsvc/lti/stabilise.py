"""Stabilising gains of minimum energy, without weights to tune.

Only the modes that lack the required margin are moved: they are mirrored at the margin (the minimum-energy solution of
the regulator problem with no state weight). A plant that already has the margin gets the gain zero.

Finding the observer hidden in a controller: which half of the loop's poles is state feedback, which is observer.

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
from scipy.linalg import schur, solve_continuous_lyapunov, solve_discrete_lyapunov

from afdsvc.errors import IllConditioned
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.stability import closed_loop_matrix, describe_pole, eigenvalues
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace, common_dt

CONTROLLABILITY_LIMIT = 1e-12


def half_margin(plant: StateSpace, controller: StateSpace) -> float:
    """Return half the stability margin of the loop: half of ``1 - max|z|``, or of ``-max Re s``."""
    poles = eigenvalues(closed_loop_matrix(plant, controller))
    if not poles.size:
        return 0.0
    discrete = common_dt(plant, controller) > 0
    return 0.5 * float(1 - np.abs(poles).max() if discrete else -poles.real.max())


def gain_with_margin(A: Array, B: Array, dt: float, margin: float) -> Array:
    """Return F, shape ``(m, n)``, such that A + B F has the required stability margin.

    Raises `IllConditioned` with the pole when a mode that lacks the margin cannot be reached from the inputs.
    """
    n, m = B.shape
    if not n:
        return np.zeros((m, 0))
    t = state_scaling(A)
    As, Bs = A * (t[None, :] / t[:, None]), B / t[:, None]
    columns = np.linalg.norm(Bs, axis=0)
    weight = 1 / np.where(columns > 0, columns, 1.0)
    shifted = As / (1 - margin) if dt > 0 else As + margin * np.eye(n)
    _, F = minimum_energy_regulator(shifted, Bs * weight / ((1 - margin) if dt > 0 else 1.0), dt > 0)
    return weight[:, None] * F / t[None, :]


def minimum_energy_regulator(A: Array, B: Array, discrete: bool) -> tuple[Array, Array]:
    """Return X and F of the regulator problem without state weight and with input weight I, ``u = F x``.

    Every unstable eigenvalue of A is mirrored at the border of stability, the others stay; X is zero on the stable
    subspace. A Lyapunov equation on the unstable subspace gives it, where a Riccati solver would stumble over poles that
    come in mirrored pairs (an undamped magnetic bearing). Raises `IllConditioned` when a mode cannot be reached.
    """
    stable = (lambda re, im: re * re + im * im < 1) if discrete else (lambda re, im: re < 0)
    T, Z, k = schur(A, output="real", sort=stable)
    if k == A.shape[0]:
        return np.zeros(A.shape), np.zeros(B.T.shape)
    A2, B2 = T[k:, k:], Z[:, k:].T @ B
    Y = _inverse_cost(A2, B2, discrete)
    smallest, largest = np.linalg.eigvalsh(Y)[[0, -1]]
    if not smallest > CONTROLLABILITY_LIMIT * max(largest, 1e-300):
        pole = complex(np.linalg.eigvals(A2)[0])
        raise IllConditioned(
            f"the mode near {describe_pole(pole, float(discrete))} cannot be reached (relative controllability "
            f"{smallest / max(largest, 1e-300):.1e}, expected above {CONTROLLABILITY_LIMIT:.0e}): give the gain "
            "yourself, move the input or output, or reduce the model"
        )
    P = np.linalg.inv(Y)
    weight = np.eye(B.shape[1]) + B2.T @ P @ B2 if discrete else np.eye(B.shape[1])
    F2 = -np.linalg.solve(weight, B2.T @ P @ A2 if discrete else B2.T @ P)
    return Z[:, k:] @ P @ Z[:, k:].T, F2 @ Z[:, k:].T


def _inverse_cost(A2: Array, B2: Array, discrete: bool) -> Array:
    """Return Y, the inverse of the cost on the unstable subspace: ``A2 Y A2' - Y = B2 B2'`` or ``A2 Y + Y A2' = B2 B2'``."""
    if discrete:
        inverse = np.linalg.inv(A2)
        Y = solve_discrete_lyapunov(inverse, inverse @ B2 @ B2.T @ inverse.T)
    else:
        Y = solve_continuous_lyapunov(A2, B2 @ B2.T)
    return np.asarray(Y + Y.T, dtype=np.float64) / 2


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
