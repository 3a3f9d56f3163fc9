"""The steady Kalman gain of the predictor, for a stated share of unknown forces."""

from __future__ import annotations

import warnings

import numpy as np
import scipy.linalg as sla

from afdsvc.api.model import Model
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.steps import substep_matrices
from afdsvc.lti.statespace import Array

SENSOR_NOISE = 1e-3  # rms of the sensor noise over the rms of the output
REGULARISATION = (0.0, 1e-9, 1e-6, 1e-4, 1e-2)  # share by which the poles are drawn in, tried in turn


def correction_gain(nominal: Nominal, theta: Array, sizes: tuple[Array, Array], rho: float) -> Array:
    """Return the gain ``Kp (n, p)`` of ``x+ = A x + B u + Kp (y - yhat)``; zeros for ``rho = 0``.

    ``sizes`` are the rms of the nominal rate of change of every state ``(n,)`` and of the outputs ``(p,)``. Unknown forces of rms ``rho`` times the nominal force, independent from sample to sample and held over one, act on the
    velocities (on all states of a plant without axes); the sensor noise is 0.1 % of the output. ``rho`` going to zero gives a
    simulation, a large one a one-step predictor. Where the Riccati equation has no solution (an integrator no output sees)
    the poles are drawn in a little; where nothing helps the gain is zero.
    """
    n, p = nominal.plant.order, nominal.plant.outputs
    if rho <= 0 or n == 0:
        return np.zeros((n, p))
    plant = nominal.at(np.asarray(theta, dtype=np.float64))
    s = substep_matrices(plant, nominal.dt, 1, np.inf)
    force = np.where(driven(nominal.model, n), np.asarray(sizes[0], dtype=np.float64), 0.0) * rho
    Q = (s.gx * force**2) @ s.gx.T
    R = np.diag(np.maximum(SENSOR_NOISE * np.asarray(sizes[1], dtype=np.float64), 1e-150) ** 2)
    for drawn in REGULARISATION:
        gain = _steady(s.phi, plant.C, Q + drawn * np.diag(np.diag(Q)), R, drawn)
        if gain is not None:
            return gain
    return np.zeros((n, p))


def driven(model: Model, n: int) -> Array:
    """Return the states that unknown forces act on, shape ``(n,)``: velocities, or all where no state is one."""
    rates = np.array([v.rate_of is not None for v in model.states] if len(model.states) == n else [False] * n)
    return rates if rates.any() else np.ones(n, dtype=bool)


def _steady(A: Array, C: Array, Q: Array, R: Array, drawn: float) -> Array | None:
    """Return the steady gain of the predictor; None without a solution that is finite and stable."""
    F = (1 - drawn) * A
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            P = sla.solve_discrete_are(F.T, C.T, Q, R)
            gain = np.asarray(F @ sla.solve(C @ P @ C.T + R, C @ P, assume_a="pos").T)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(gain).all() or np.abs(np.linalg.eigvals(F - gain @ C)).max() >= 1:
        return None
    return gain
