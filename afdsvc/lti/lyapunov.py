"""The discrete Lyapunov equation: the steady covariance of a stable system's state."""

from __future__ import annotations

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

DOUBLINGS = 64  # 2**64 samples: a pole that has not decayed by then is on the unit circle


def discrete_lyapunov(A: Array, Q: Array) -> Array:
    """Return ``P (n, n)`` with ``P = A P A' + Q``, the sum of ``A^k Q A'^k``, for a stable A.

    The number of terms doubles in every step, and all of them are positive for a covariance Q, so nothing cancels. The bilinear
    transformation (SciPy's for ten states and more) loses all digits where poles are near -1. Source: R. A. Smith, "Matrix equation
    XA + BX = C", SIAM J. Appl. Math. 16, 1968. Raises `BadInput` for a pole on or outside the unit circle.

    >>> float(discrete_lyapunov(np.array([[-0.5]]), np.array([[3.0]]))[0, 0])
    4.0
    """
    power, P = np.array(A, dtype=np.float64), np.array(Q, dtype=np.float64)
    for _ in range(DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):
            P, before, power = P + power @ P @ power.T, P, power @ power
        if not np.isfinite(P).all():
            break
        if np.abs(P - before).max(initial=0.0) <= np.finfo(float).eps * np.abs(P).max(initial=0.0):
            return (P + P.T) / 2
    raise BadInput(f"the system has a pole of modulus {np.abs(np.linalg.eigvals(A)).max():.6g}; expected a stable one")
