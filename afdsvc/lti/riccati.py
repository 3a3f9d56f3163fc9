"""Riccati equations whose solutions are checked: a solution that does not stabilise is refused, with its eigenvalue."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_are, solve_discrete_are

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.scaling import state_scaling
from afdsvc.lti.stability import describe_pole, worst_pole
from afdsvc.lti.statespace import Array, StateSpace

STABILISING_MARGIN = 1e-9


def riccati(A: Array, B: Array, Q: Array, R: Array, S: Array, dt: float) -> tuple[Array, Array]:
    """Return the stabilising solution X and the gain F (``u = F x``, so A + B F is stable) of the regulator problem.

    Minimises the sum (integral) of ``x'Qx + u'Ru + 2 x'Su``. Discrete for ``dt > 0``, else continuous. Computed in
    balanced states. Raises `IllConditioned` when no stabilising solution exists: then a mode on the border of stability
    is not weighted, or an unstable one not reachable.
    """
    n = A.shape[0]
    if not n:
        return np.zeros((0, 0)), np.zeros((B.shape[1], 0))
    t = state_scaling(A)
    As, Bs = A * (t[None, :] / t[:, None]), B / t[:, None]
    Qs, Ss = Q * (t[:, None] * t[None, :]), S * t[:, None]
    X = _solve(As, Bs, Qs, R, Ss, dt)
    F = -np.linalg.solve(R + Bs.T @ X @ Bs, Bs.T @ X @ As + Ss.T) if dt > 0 else -np.linalg.solve(R, Bs.T @ X + Ss.T)
    pole, margin = worst_pole(As + Bs @ F, dt)
    if not margin > STABILISING_MARGIN:
        raise IllConditioned(_no_solution(f"the best found leaves the pole {describe_pole(pole, dt)}"))
    return X / (t[:, None] * t[None, :]), F / t[None, :]


def _solve(A: Array, B: Array, Q: Array, R: Array, S: Array, dt: float) -> Array:
    solver = solve_discrete_are if dt > 0 else solve_continuous_are
    try:
        X = solver(A, B, (Q + Q.T) / 2, (R + R.T) / 2, s=S)
    except (np.linalg.LinAlgError, ValueError) as failed:
        raise IllConditioned(_no_solution(str(failed).rstrip("."))) from failed
    return np.asarray(X + X.T, dtype=np.float64) / 2


def _no_solution(found: str) -> str:
    return (
        f"the Riccati equation has no stabilising solution ({found}): a mode on the border of stability carries no "
        "weight (or no noise), or an unstable mode cannot be reached; add weight or noise there, or change the model"
    )


def lqr(plant: StateSpace, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None) -> Array:
    """Return the gain F, shape ``(m, n)``, of ``u = F x`` (positive sign) minimising ``x'Qx + u'Ru + 2x'Su``."""
    n, m = plant.order, plant.inputs
    cross = np.zeros((n, m)) if S is None else _sized("S", S, (n, m))
    return riccati(plant.A, plant.B, _weight("Q", Q, n), _positive("R", R, m), cross, plant.dt)[1]


def kalman_predictor_gain(
    plant: StateSpace, process_cov: ArrayLike, output_cov: ArrayLike, cross_cov: ArrayLike | None = None
) -> Array:
    """Return the observer gain L, shape ``(n, p)``, of ``x^+ = A x^ + B u + L (C x^ + D u - y)``, optimal for the
    noises.

    L is minus the predictor gain ``A P C' (C P C' + Rv)^-1`` (not the filter gain ``P C' (..)^-1``), so A + L C is
    stable. ``process_cov (n, n)`` belongs to noise on the states, ``output_cov (p, p)`` on the outputs; in continuous
    time they are intensities.
    """
    n, p = plant.order, plant.outputs
    cross = np.zeros((n, p)) if cross_cov is None else _sized("cross_cov", cross_cov, (n, p))
    Q, R = _weight("process_cov", process_cov, n), _positive("output_cov", output_cov, p)
    return riccati(plant.A.T, plant.C.T, Q, R, cross, plant.dt)[1].T


def _sized(name: str, value: ArrayLike, shape: tuple[int, int]) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise BadInput(f"{name} has shape {array.shape}; expected a finite matrix of shape {shape}")
    return array


def covariance(name: str, value: ArrayLike, n: int, definite: bool = True) -> Array:
    """Return a covariance ``(n, n)``, symmetric and positive (semi)definite; a scalar means that times I."""
    return _positive(name, value, n) if definite else _weight(name, value, n)


def cross_covariance(value: ArrayLike, Q: Array, R: Array) -> Array:
    """Return the covariance ``(n, p)`` of state and output noise; raises `BadInput` if Q and R do not allow it."""
    S = _sized("cross_cov", value, (Q.shape[0], R.shape[0]))
    _weight("[process_cov cross_cov; cross_cov' output_cov]", np.block([[Q, S], [S.T, R]]), Q.shape[0] + R.shape[0])
    return S


def _weight(name: str, value: ArrayLike, n: int) -> Array:
    """Return a symmetric positive semidefinite matrix; a scalar means that times the identity."""
    array = np.asarray(value, dtype=np.float64)
    array = float(array) * np.eye(n) if array.ndim == 0 else _sized(name, array, (n, n))
    if not np.allclose(array, array.T, rtol=1e-9, atol=0):
        raise BadInput(
            f"{name} is not symmetric (largest difference {np.abs(array - array.T).max():.2g}); expected a symmetric matrix"
        )
    smallest, largest = (np.linalg.eigvalsh(array)[[0, -1]]) if n else (0.0, 0.0)
    if smallest < -1e-10 * max(largest, 0.0) or largest < 0:
        raise BadInput(f"{name} has the eigenvalue {smallest:.3g}; expected a positive semidefinite matrix")
    return array


def _positive(name: str, value: ArrayLike, n: int) -> Array:
    """Return a symmetric positive definite matrix; a scalar means that times the identity."""
    array = _weight(name, value, n)
    smallest, largest = (np.linalg.eigvalsh(array)[[0, -1]]) if n else (1.0, 1.0)
    if not smallest > 1e-14 * largest:
        raise BadInput(f"{name} is singular (smallest eigenvalue {smallest:.3g}); expected a positive definite matrix")
    return array
