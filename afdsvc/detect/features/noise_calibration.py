"""The noise of a machine from its own quiet data: how much is measured wrongly, how much shakes the plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from afdsvc.detect.features.innovations import ResidualFilter
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Covariance of the output noise ``(p, p)`` and of the process noise on the states ``(n, n)``; ``covariance`` is
    that of the residual they lead to, ``ratio`` the process noise on the inputs over the output noise.
    """

    output_cov: Array
    process_cov: Array
    covariance: Array
    ratio: float


def calibrate_noise(plant: StateSpace, u: Array, y: Array, shortest: int = 500) -> NoiseModel:
    """Return the noise model that makes quiet data likeliest, with noise on the inputs and white noise on the outputs.

    ``u (n, m)`` and ``y (n, p)`` are samples without excitation bursts and without faults. For each ratio of the two
    noises the innovations filter is fixed and its residual covariance follows in closed form, so one number is
    searched (profile likelihood). Raises `BadInput` when there are too few samples.
    """
    if len(y) < shortest:
        raise BadInput(f"{len(y)} quiet samples are too few to calibrate the noise; expected at least {shortest}")
    scale = np.maximum(_step_variance(y), 1e-30)
    drive = plant.B @ np.diag(_input_scale(u)) @ plant.B.T

    def residual(log_ratio: float) -> Array:
        q = 10**log_ratio * float(scale.mean()) / max(float(np.trace(drive)), 1e-300)
        filt = innovations(plant, np.diag(scale), q * drive).filter
        f = ResidualFilter(filt)
        _, r = f.step(f.start(), y, u)
        return r[min(f.settling(1e-3), len(r) // 4) :]

    def cost(log_ratio: float) -> float:
        return float(np.linalg.slogdet(np.atleast_2d(_covariance(residual(log_ratio))))[1])

    best = minimize_scalar(cost, bounds=(-12.0, 8.0), method="bounded", options={"xatol": 0.05})
    covariance = _covariance(residual(float(best.x)))
    return _scaled(plant, scale, drive, float(best.x), covariance)


def _scaled(plant: StateSpace, scale: Array, drive: Array, log_ratio: float, covariance: Array) -> NoiseModel:
    """Scale both noises together so that the residual has the covariance that was seen."""
    q = 10**log_ratio * float(scale.mean()) / max(float(np.trace(drive)), 1e-300)
    unit = innovations(plant, np.diag(scale), q * drive).covariance
    factor = float(np.trace(np.linalg.solve(unit, covariance))) / len(scale)
    return NoiseModel(factor * np.diag(scale), factor * q * drive, covariance, 10**log_ratio)


def _step_variance(y: Array) -> Array:
    """Variance of white noise that would explain the second differences: blind to slow motion."""
    return np.asarray(np.mean(np.diff(y, n=2, axis=0) ** 2, axis=0) / 6.0)


def _input_scale(u: Array) -> Array:
    variance = np.var(u, axis=0)
    return np.where(variance > 0, variance, 1.0)


def _covariance(r: Array) -> Array:
    return np.atleast_2d(r.T @ r / len(r))
