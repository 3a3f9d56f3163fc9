"""Norms of stable discrete systems: what white noise makes of the output (H2) and the largest gain (H-infinity).

Sources: K. Zhou and J. C. Doyle, "Essentials of Robust Control", Prentice Hall, 1998, chapters 4 and 6; N. A. Bruinsma and M. Steinbuch,
"A fast algorithm to compute the H-infinity norm of a transfer function matrix", Systems and Control Letters 14, 1990.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvals

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import transfer
from afdsvc.lti.lyapunov import discrete_lyapunov
from afdsvc.lti.scaling import balanced
from afdsvc.lti.stability import require_stable
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

TOLERANCE = 1e-4  # relative, of the largest gain; its result is above the gain by at most twice as much
ON_CIRCLE = 1e-6  # an eigenvalue of the pencil this close to the unit circle counts as on it


def output_covariance(system: StateSpace) -> Array:
    """Return the steady covariance ``(p, p)`` of the output for unit white noise at the inputs; its trace is the squared H2 norm.

    Raises `BadInput` with the pole for an unstable system.

    >>> bool(np.allclose(output_covariance(StateSpace.of([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0)), 4 / 3))
    True
    """
    _require_discrete(system)
    scaled, _ = balanced(system)
    P = discrete_lyapunov(scaled.A, scaled.B @ scaled.B.T) if system.order else np.zeros((0, 0))
    return np.asarray(scaled.C @ P @ scaled.C.T + scaled.D @ scaled.D.T, dtype=np.float64)


def largest_gain(system: StateSpace) -> float:
    """Return the H-infinity norm, the largest singular value over all frequencies, from above and to 0.02 %.

    No frequency in between is overlooked: the eigenvalues of a symplectic pencil say where a gain is reached. Raises `BadInput` with the
    pole for an unstable system.

    >>> 10.0 <= largest_gain(StateSpace.of([[0.9]], [[1.0]], [[1.0]], [[0.0]], 1.0)) < 10.01
    True
    """
    _require_discrete(system)
    scaled, _ = balanced(system)
    angles = np.unique(np.concatenate([np.abs(np.angle(scaled.poles())), [0.0, np.pi]]))
    reached = float(_gains(scaled, angles).max(initial=0.0))
    while reached > 0:
        crossed = _reached_at(scaled, (1 + TOLERANCE) * reached)
        if not crossed.size:
            break
        between = (crossed + np.roll(crossed, -1)) / 2 + np.where(np.arange(crossed.size) == crossed.size - 1, np.pi, 0.0)
        better = float(_gains(scaled, np.concatenate([crossed, between])).max())
        if not better > (1 + TOLERANCE) * reached:  # rounding put eigenvalues on the circle
            break
        reached = better
    return (1 + 2 * TOLERANCE) * reached


def _reached_at(system: StateSpace, gain: float) -> Array:
    """Return the angles, rising, at which some singular value equals the gain: where ``gain^2 I - G~ G`` is singular on the circle."""
    A, B, C, D = system.A, system.B / gain, system.C, system.D / gain
    n, m = B.shape
    E = np.block([[np.eye(n), np.zeros((n, n + m))], [np.zeros((n, n)), A.T, np.zeros((n, m))], [np.zeros((m, n)), B.T, np.zeros((m, m))]])
    F = np.block([[A, np.zeros((n, n)), B], [-C.T @ C, np.eye(n), -C.T @ D], [-D.T @ C, np.zeros((m, n)), np.eye(m) - D.T @ D]])
    with np.errstate(divide="ignore", invalid="ignore"):
        values = eigvals(F, E)
    values = values[np.isfinite(values)]
    return np.asarray(np.sort(np.angle(values[np.abs(np.abs(values) - 1) < ON_CIRCLE])), dtype=np.float64)


def _gains(system: StateSpace, angles: Array) -> Array:
    points: ComplexArray = np.exp(1j * angles)
    return np.asarray(np.linalg.norm(transfer(system, points), 2, axis=(1, 2)), dtype=np.float64)


def _require_discrete(system: StateSpace) -> None:
    if system.order and not system.discrete:
        raise BadInput("a continuous system; expected a discrete one (sample it with afdsvc.lti.sampling.sample_zoh)")
    require_stable(system.A, system.dt or 1.0, "the system", "its norms exist for stable systems only")
