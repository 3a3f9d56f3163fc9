"""From continuous to discrete time: inputs held between samples, white noise integrated over them."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from afdsvc.errors import BadInput
from afdsvc.lti.scaling import balanced, rescale
from afdsvc.lti.statespace import Array, StateSpace


def sample_zoh(system: StateSpace, dt: float) -> StateSpace:
    """Return the discrete system with sample time ``dt`` [s] that agrees with the continuous one at the samples.

    The input is held over each sample period (zero-order hold); exact, also for a singular A.
    """
    if system.discrete:
        raise BadInput(f"the system is discrete already (sample time {system.dt} s); expected a continuous one")
    if not (np.isfinite(dt) and dt > 0):
        raise BadInput(f"sample time {dt} s; expected a positive number")
    scaled, t = balanced(system)
    n, m = system.B.shape
    step = expm(np.block([[scaled.A, scaled.B], [np.zeros((m, n + m))]]) * dt)
    sampled = StateSpace(step[:n, :n], step[:n, n:], scaled.C, scaled.D, float(dt))
    return rescale(sampled, 1 / t)


def sample_noise(A: Array, intensity: Array, dt: float) -> Array:
    """Return the covariance per sample of white noise of the given ``intensity (n, n)`` on the states of a continuous system.

    ``int_0^dt e^(A t) Q e^(A' t) dt`` (C. F. Van Loan, *IEEE Trans. Autom. Control* 23, 1978).
    """
    n = len(A)
    step = expm(np.block([[-A, intensity], [np.zeros((n, n)), A.T]]) * dt)
    Q = step[n:, n:].T @ step[:n, n:]
    return np.asarray((Q + Q.T) / 2)
