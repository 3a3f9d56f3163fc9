"""From continuous to discrete time with inputs held between samples."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from afdsvc.errors import BadInput
from afdsvc.lti.scaling import balanced, rescale
from afdsvc.lti.statespace import StateSpace


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
