"""Frequency responses, many frequencies at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import schur

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.scaling import balanced
from afdsvc.lti.statespace import ComplexArray, StateSpace


def frequency_response(system: StateSpace, omega_rad_s: ArrayLike) -> ComplexArray:
    """Return ``C (s I - A)^-1 B + D`` at ``s = j omega`` (continuous) or ``z = exp(j omega dt)`` (discrete).

    ``omega_rad_s`` has shape ``(k,)`` (or is one number) in rad/s; the result has shape ``(k, p, m)``. Raises
    `IllConditioned` when a frequency sits on a pole.
    """
    omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
    if omega.ndim != 1 or not np.isfinite(omega).all():
        raise BadInput(f"frequencies of shape {omega.shape}: expected a vector of finite numbers in rad/s")
    points = np.exp(1j * omega * system.dt) if system.discrete else 1j * omega
    return transfer(system, np.asarray(points, dtype=np.complex128))


def transfer(system: StateSpace, points: ComplexArray) -> ComplexArray:
    """Return the transfer matrix at complex points s or z, shape ``(k, p, m)``.

    One Schur form for all points, back-substitution vectorised over the points, and one step of refinement: backward
    stable whatever the eigenvectors look like, and accurate when fast and slow states live in one matrix.
    """
    D = np.broadcast_to(system.D.astype(np.complex128), (points.size, *system.D.shape))
    if not system.order or not points.size:
        return D.copy()
    scaled, _ = balanced(system)
    T, Z = (np.asarray(x, dtype=np.complex128) for x in schur(scaled.A, output="complex"))
    n, m, k = system.order, system.inputs, points.size
    B = np.broadcast_to(scaled.B[:, :, None], (n, m, k)).reshape(n, m * k)
    repeated = np.tile(points, m)
    X = Z @ _solve_triangular(T, Z.conj().T @ B, repeated)
    X += Z @ _solve_triangular(T, Z.conj().T @ (B - repeated * X + scaled.A @ X), repeated)
    return D + np.moveaxis((scaled.C @ X).reshape(-1, m, k), 2, 0)


def _solve_triangular(T: ComplexArray, rhs: ComplexArray, points: ComplexArray) -> ComplexArray:
    """Return the solutions of ``(s_k I - T) x_k = rhs_k`` for upper triangular T, one column for each point."""
    X = np.empty_like(rhs)
    for i in range(T.shape[0] - 1, -1, -1):
        pivot = points - T[i, i]
        if not np.abs(pivot).min() > 0:
            raise IllConditioned(f"a frequency coincides with the pole {T[i, i]:.6g}; leave it out")
        X[i] = (rhs[i] + T[i, i + 1 :] @ X[i + 1 :]) / pivot
    return X
