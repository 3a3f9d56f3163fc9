"""Stabilising gains of minimum energy, without weights to tune.

Only the modes that lack the required margin are moved: they are mirrored at the margin (the minimum-energy solution of
the regulator problem with no state weight). A plant that already has the margin gets the gain zero.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import schur, solve_continuous_lyapunov, solve_discrete_lyapunov

from afdsvc.errors import IllConditioned
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.stability import closed_loop_matrix, describe_pole, eigenvalues
from afdsvc.lti.statespace import Array, StateSpace, common_dt

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
    _, F = mirror(shifted, Bs * weight / ((1 - margin) if dt > 0 else 1.0), dt > 0)
    return weight[:, None] * F / t[None, :]


def mirror(A: Array, B: Array, discrete: bool) -> tuple[Array, Array]:
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
