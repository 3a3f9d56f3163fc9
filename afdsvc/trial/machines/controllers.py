"""Controllers of the made-up machines, as sampled systems with inputs ``[y - ref, alpha]`` and output u (u = K y + ...)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from afdsvc.lti.statespace import Array, StateSpace


def held(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Return A and B of the plant sampled with a zero-order hold."""
    n, m = B.shape
    both = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return both[:n, :n], both[:n, n:]


def lqg(A: Array, B: Array, C: Array, dt: float, state_weight: Array, process_weight: float) -> tuple[StateSpace, StateSpace]:
    """Return the loop ``[y, alpha] -> u`` in observer form and K alone (``y -> u``), unit input and measurement weights.

    Observer x+ = A x + B u + L (C x - y), u = F x + alpha: alpha goes into the observer too, as in J_K.
    """
    Ad, Bd = held(A, B, dt)
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    X = solve_discrete_are(Ad, Bd, np.diag(state_weight), np.eye(m))
    F = -np.linalg.solve(np.eye(m) + Bd.T @ X @ Bd, Bd.T @ X @ Ad)
    Y = solve_discrete_are(Ad.T, C.T, process_weight * np.eye(n), np.eye(p))
    L = -np.linalg.solve(np.eye(p) + C @ Y @ C.T, C @ Y @ Ad.T).T
    inner = Ad + Bd @ F + L @ C
    K = StateSpace.of(inner, -L, F, np.zeros((m, p)), dt)
    return StateSpace.of(inner, np.hstack([-L, Bd]), F, np.hstack([np.zeros((m, p)), np.eye(m)]), dt), K


def additive(K: StateSpace) -> StateSpace:
    """Return ``u = K (y - ref) + alpha`` as one system."""
    m = K.outputs
    return StateSpace(K.A, np.hstack([K.B, np.zeros((K.order, m))]), K.C, np.hstack([K.D, np.eye(m)]), K.dt)


def proportional(gain: float, channels: int, dt: float) -> StateSpace:
    """Return u = gain y on every channel."""
    return StateSpace.gain(gain * np.eye(channels), dt)


def filtered_pd(kp: float, kd: float, tau: float, dt: float) -> StateSpace:
    """Return u = -(kp + kd s / (tau s + 1)) y, the derivative by backward differences."""
    a, b = tau / (tau + dt), kd / (tau + dt)
    return StateSpace.of([[a]], [[a * b - b]], [[-1.0]], [[-(kp + b)]], dt)
