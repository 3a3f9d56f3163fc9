"""Phases that give a sum of sines a low peak at the same power.

Starting from Schroeder's phases (M. R. Schroeder, *IEEE Trans. Inf. Theory* 16, 1970) the p-norm of the waves is
minimised for growing p, which tends to the peak (P. Guillaume et al., *IEEE Trans. Instrum. Meas.* 40, 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from afdsvc.api.bursts import Line
from afdsvc.lti.statespace import Array, ComplexArray

POWERS = (4, 8, 16, 32)
SAMPLES = 4096


def low_crest(lines: Sequence[Line], responses: ComplexArray, seconds: float, bounds: Array) -> tuple[Line, ...]:
    """Return the lines with new phases.

    ``responses (L, s)`` lead from each line's input to the s signals whose peaks matter (outputs, actuators), ``bounds
    (s,)`` are their limits: the largest share of a limit is made small over ``seconds`` seconds.
    """
    if len(lines) < 2:
        return tuple(lines)
    waves = _waves(lines, responses / bounds, seconds)
    power = np.array([line.amplitude**2 for line in lines])
    phases = -2 * np.pi * np.cumsum(np.cumsum(power / power.sum()))
    best = min((np.zeros(len(lines)), phases), key=lambda p: peak(waves, p))
    for exponent in POWERS:
        found = minimize(_norm, best, args=(waves, exponent), jac=True, method="L-BFGS-B", options={"maxiter": 200})
        if peak(waves, found.x) < peak(waves, best):
            best = found.x
    return tuple(replace(line, phase=float(p % (2 * np.pi))) for line, p in zip(lines, best, strict=True))


def peak(waves: ComplexArray, phases: Array) -> float:
    """Return the largest value of all signals for the given phases."""
    return float(np.abs(np.imag(np.einsum("l,lst->st", np.exp(1j * phases), waves))).max())


def _waves(lines: Sequence[Line], responses: ComplexArray, seconds: float) -> ComplexArray:
    """Return complex waves ``(L, s, t)`` of every line at every signal, phases not yet applied."""
    t = np.linspace(0, seconds, SAMPLES, endpoint=False)
    turning = np.exp(1j * np.array([line.omega for line in lines])[:, None] * t[None, :])
    amplitude = np.array([line.amplitude for line in lines])
    return np.asarray(amplitude[:, None, None] * responses[:, :, None] * turning[:, None, :])


def _norm(phases: Array, waves: ComplexArray, exponent: int) -> tuple[float, Array]:
    """Return the p-norm of all samples of all signals, normalised to the peak, and its gradient."""
    turned = np.exp(1j * phases)[:, None, None] * waves
    total = np.imag(turned.sum(axis=0))
    scale = max(float(np.abs(total).max()), 1e-300)
    share = np.abs(total) / scale
    mean = float(np.mean(share**exponent))
    outer = np.sign(total) * share ** (exponent - 1)
    gradient = np.einsum("lst,st->l", np.real(turned), outer) / total.size * mean ** (1 / exponent - 1)
    return scale * mean ** (1 / exponent), np.asarray(gradient)
