"""Frequency responses, many frequencies at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import schur

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.balance import balanced
from afdsvc.lti.statespace import ComplexArray, StateSpace


def frequency_response(system: StateSpace, omega_rad_s: ArrayLike) -> ComplexArray:
    """Return ``C (s I - A)^-1 B + D`` at ``s = j omega`` (continuous) or ``z = exp(j omega dt)`` (discrete).

    ``omega_rad_s`` has shape ``(k,)`` (or is one number) in rad/s; the result has shape ``(k, p, m)``. Raises
    `IllConditioned` when a frequency sits on a pole.
    """
    omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
    if omega.ndim != 1 or not np.isfinite(omega).all():
        raise BadInput(f"frequencies of shape {omega.shape}: a vector of finite numbers in rad/s is wanted")
    points = np.exp(1j * omega * system.dt) if system.discrete else 1j * omega
    return transfer(system, np.asarray(points, dtype=np.complex128))


def transfer(system: StateSpace, points: ComplexArray) -> ComplexArray:
    """Return the transfer matrix at complex points s or z, shape ``(k, p, m)``.

    One Schur form for all points, then back-substitution vectorised over the points: backward stable whatever the
    eigenvectors look like.
    """
    D = np.broadcast_to(system.D.astype(np.complex128), (points.size, *system.D.shape))
    if not system.order or not points.size:
        return D.copy()
    scaled, _ = balanced(system)
    T, Z = schur(scaled.A, output="complex")
    X = _solve_triangular(np.asarray(T), Z.conj().T @ scaled.B, points)
    # (p, n) @ (n, m * k) in one product
    n, m, k = system.order, system.inputs, points.size
    return D + np.moveaxis(((scaled.C @ Z) @ X.reshape(n, m * k)).reshape(-1, m, k), 2, 0)


def _solve_triangular(T: ComplexArray, rhs: ComplexArray, points: ComplexArray) -> ComplexArray:
    """Return the solutions of ``(s_k I - T) X_k = rhs`` for upper triangular T, shape ``(n, m, k)``."""
    n, m = rhs.shape
    X = np.empty((n, m, points.size), dtype=np.complex128)
    for i in range(n - 1, -1, -1):
        pivot = points - T[i, i]
        if not np.abs(pivot).min() > 0:
            raise IllConditioned(f"a frequency sits exactly on the pole {T[i, i]:.6g}; leave it out")
        carried = (T[i, i + 1 :] @ X[i + 1 :].reshape(n - 1 - i, -1)).reshape(m, -1) if i < n - 1 else 0.0
        X[i] = (rhs[i][:, None] + carried) / pivot
    return X
