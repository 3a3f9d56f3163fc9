"""Internal scaling: systems that mix um, um/s and 1e6 N/kg/um are computed in balanced coordinates.

The scaling factors are powers of two, so that going there and back costs no accuracy at all.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import matrix_balance

from afdsvc.lti.statespace import Array, StateSpace


def state_scaling(A: Array) -> Array:
    """Return ``t (n,)``, powers of two, such that ``A[i, j] t[j] / t[i]`` has rows and columns of like size."""
    if A.shape[0] < 2:
        return np.ones(A.shape[0])
    _, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(scale, dtype=np.float64)


def rescale(system: StateSpace, t: Array) -> StateSpace:
    """Return the system with states ``x / t``."""
    return StateSpace(system.A * (t[None, :] / t[:, None]), system.B / t[:, None], system.C * t[None, :], system.D, system.dt)


def balanced(system: StateSpace) -> tuple[StateSpace, Array]:
    """Return the system in scaled states ``x / t`` and ``t``."""
    t = state_scaling(system.A)
    return rescale(system, t), t
