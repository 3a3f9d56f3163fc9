"""Steps of CUSUMs whose regressors are driven by noise: how large they are where an excursion begins and where it alarms.

A boundary is overshot by about half a step, and zero undershot by as much (D. Siegmund, *Sequential Analysis*, 1985). Steps
come in where information comes in, so the mean step there is ``E |s|^3 / E |s|^2``, s being theta psi over one look. An
excursion begins with the healthy loop's psi. Those that alarm look as if the fault were there: at their end psi is that of
the loop in which ``e + theta psi`` stands for e, which the likelihood ratio weights them to. A weakened loop is a quieter one,
so its steps can be half as large.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from afdsvc.detect.noise_driven import NoiseDriven
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


def excursion_steps(noise: NoiseDriven, which: NDArray[np.intp], theta: Array, samples: int) -> Array:
    """Return the mean of the steps at both ends of an excursion for CUSUMs of the faults ``which`` at severities ``theta``,
    which look once in so many ``samples``; shape ``(K,)``.
    """
    return np.array([_both_ends(noise, int(i), float(th), samples) for i, th in zip(which, theta, strict=True)])


def faulty_information(noise: NoiseDriven, fault: int, severity: float) -> float:
    """Return the information per sample about a fault once it is there; raises `BadInput` when the loop is lost."""
    A, B, C = _driven(noise, fault)
    tilted = A + severity * B @ C
    if np.abs(np.linalg.eigvals(tilted)).max(initial=0.0) >= 1:
        raise BadInput(f"severity {severity:g} makes the loop unstable; one it survives is wanted")
    return float(np.trace(C @ solve_discrete_lyapunov(tilted, B @ B.T) @ C.T))


def _both_ends(noise: NoiseDriven, fault: int, theta: float, samples: int) -> float:
    A, B, C = _driven(noise, fault)
    begins, tilted = _mean_step(A, B, C, samples), A + theta * B @ C
    alarms = _mean_step(tilted, B, C, samples) if np.abs(np.linalg.eigvals(tilted)).max(initial=0.0) < 1 else begins
    return abs(theta) * (begins + alarms) / 2


def _driven(noise: NoiseDriven, fault: int) -> tuple[Array, Array, Array]:
    """Return the part of the loop from normalised residual to psi of one fault that this psi can see."""
    p = noise.loop.outputs // noise.count
    A, B, C = noise.loop.A, noise.loop.B[:, :p], noise.loop.C[p * fault : p * (fault + 1)]
    seen = np.abs(C).sum(axis=0) > 0
    while True:
        more = seen | (np.abs(A[seen]).sum(axis=0) > 0)
        if more.sum() == seen.sum():
            return A[np.ix_(seen, seen)], B[seen], C[:, seen]
        seen = more


def _mean_step(A: Array, B: Array, C: Array, samples: int) -> float:
    """Return ``E I^(3/2) / E I`` for the information ``I = sum |psi|^2`` of so many samples, taken as Gamma distributed."""
    P = solve_discrete_lyapunov(A, B @ B.T) if len(A) else np.zeros((0, 0))
    mean = samples * float(np.trace(C @ P @ C.T))
    if not mean > 0:
        return 0.0
    variance, later = 0.0, C @ P
    for lag in range(samples):
        variance += (1 + (lag > 0)) * (samples - lag) * 2 * float(np.sum((later @ C.T) ** 2))
        later = later @ A.T
    k = mean**2 / variance
    return math.sqrt(mean) * math.exp(math.lgamma(k + 1.5) - math.lgamma(k) - 1.5 * math.log(k))
