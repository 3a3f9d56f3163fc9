"""Linear filters of the dictionary: lags, first-order lags, resonators, and the poles of the simulation itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from afdsvc.explain.gap.signals import ResidualSignals
from afdsvc.lti.statespace import Array


def lagged(z: Array, k: int) -> Array:
    """Return ``z (n,)`` lagged by ``k`` samples; before the start it holds its first value."""
    return np.concatenate([np.full(min(k, len(z)), z[0]), z[: max(len(z) - k, 0)]])


def first_order_lag(z: Array, samples: float) -> Array:
    """Return ``z (n,)`` through a first-order lag of unit gain with this time constant, settled at its first value."""
    a = float(np.exp(-1 / samples))
    return np.asarray(lfilter([1 - a], [1, -a], z, zi=[a * z[0]])[0])


def level(z: Array, samples: float) -> Array:
    """Return the slow level of ``z (n,)`` and ``z`` times its level ``(n, 2)``."""
    size = first_order_lag(np.abs(z), samples)
    return np.column_stack([size, z * size])


def resonate(z: Array, pole: complex) -> Array:
    """Return ``z (n,)`` less its mean through ``1 / (1 - pole q^-1)``: real and imaginary part ``(n, 2)``, ``(n, 1)`` if real."""
    if abs(pole.imag) < 1e-9:
        return np.asarray(lfilter([1.0], [1.0, -pole.real], z - z.mean()))[:, None]
    out = lfilter([1.0], [1.0, -pole], (z - z.mean()).astype(complex))
    return np.column_stack([out.real, out.imag])


def mode_pole(frequency: float, damping: float) -> complex:
    """Return the pole of a mode: frequency [cycles per sample], damping ratio."""
    return complex(np.exp(2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2))))


def poles(recordings: Sequence[ResidualSignals], most: int = 4) -> list[complex]:
    """Return the slowest poles of the simulation, one of each pair, from states and inputs alone.

    A least-squares fit of ``x+ = A x + B u`` is exact for a linear simulation and a linearisation for others. Poles outside
    the circle of a time constant of a quarter of the longest recording are brought back to it.
    """
    k, n = recordings[0].states.shape[1], max(len(r) for r in recordings)
    if not k or n < 3:
        return []
    now = np.vstack([np.hstack([r.states, r.inputs])[:-1] for r in recordings])
    then = np.vstack([r.states[1:] for r in recordings])
    scale = now.std(0) + 1e-300
    A = np.linalg.lstsq(now / scale, then, rcond=None)[0][:k].T / scale[:k]
    found = [complex(q * min(1.0, (1 - 4 / n) / abs(q))) for q in np.linalg.eigvals(A) if q.imag >= 0 and abs(q) > 0.2]
    return sorted(found, key=lambda q: -abs(q))[:most]
