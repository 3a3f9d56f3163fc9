"""From continuous to discrete time and back: inputs held between samples, white noise integrated over them."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.linalg import expm, logm

from afdsvc.errors import BadInput
from afdsvc.lti.scaling import balanced, rescale
from afdsvc.lti.statespace import Array, StateSpace

CONDITION = 1e6  # of eigenvectors, below which a logarithm by them keeps ten digits


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


def continuous(plant: StateSpace) -> StateSpace | None:
    """Return the continuous system whose `sample_zoh` this discrete one is; None when there is none that is real.

    A pole at zero has none, nor has one on the negative real axis: it would turn by half the sample rate, without its conjugate.
    """
    n, m = plant.B.shape
    if n == 0:
        return StateSpace.gain(plant.D)
    poles = plant.poles()
    if (np.abs(poles) < 1e-9).any() or ((poles.real < 0) & (np.abs(poles.imag) < 1e-9)).any():
        return None
    big = np.block([[plant.A, plant.B], [np.zeros((m, n)), np.eye(m)]])
    log = _logarithm(big)
    if not np.isfinite(log).all() or np.abs(np.imag(log)).max() > 1e-6 * np.abs(log).max():
        return None
    if np.abs(expm(np.real(log)) - big).max() > 1e-6 * np.abs(big).max():
        return None
    rate = np.real(log) / plant.dt
    return StateSpace(rate[:n, :n], rate[:n, n:], plant.C, plant.D)


def _logarithm(matrix: Array) -> Array:
    """Return the principal logarithm, by the eigenvectors where they are well conditioned (fifty times faster than `scipy`)."""
    values, vectors = np.linalg.eig(matrix)
    if np.linalg.cond(vectors) < CONDITION:
        return np.asarray((vectors * np.log(values.astype(complex))) @ np.linalg.inv(vectors))
    with warnings.catch_warnings():  # its estimate of the error is a few roundings; the caller checks the result
        warnings.simplefilter("ignore")
        return np.asarray(logm(matrix))


def sample_noise(A: Array, intensity: Array, dt: float) -> Array:
    """Return the covariance per sample of white noise of the given ``intensity (n, n)`` on the states of a continuous system.

    ``int_0^dt e^(A t) Q e^(A' t) dt`` (C. F. Van Loan, *IEEE Trans. Autom. Control* 23, 1978).
    """
    n = len(A)
    step = expm(np.block([[-A, intensity], [np.zeros((n, n)), A.T]]) * dt)
    Q = step[n:, n:].T @ step[:n, n:]
    return np.asarray((Q + Q.T) / 2)
