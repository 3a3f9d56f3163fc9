"""Columns made of a signal: bent functions of it, its sign, its rates, its history, slow parts of it. One array per run."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from scipy import signal

from afdsvc.lti.statespace import Array

KNOTS = (0.01, 0.12, 0.3, 0.5, 0.7, 0.88, 0.99)
RADII = (0.15, 0.4, 0.8, 1.4)  # of the rms: how far a play operator lags


def rms(x: Sequence[Array]) -> float:
    """Return the root mean square over all runs, 1 for nothing."""
    return float(np.sqrt(np.mean(np.concatenate(list(x)) ** 2))) or 1.0


def moves(x: Sequence[Array]) -> bool:
    """Whether the signal changes in any run."""
    return any(float(np.ptp(c, axis=0).max()) > 0 for c in x)


def bent(x: Sequence[Array]) -> list[Array]:
    """Return a piecewise linear function of the signal with knots at its quantiles, as hat functions."""
    knots = np.unique(np.quantile(np.concatenate(list(x)), KNOTS))
    if len(knots) < 3:
        return [np.zeros((len(c), 1)) for c in x]
    return [np.column_stack([np.interp(c, knots, e) for e in np.eye(len(knots))]) for c in x]


def signs(x: Sequence[Array]) -> list[Array]:
    """Return the sign of the signal, rounded over a tenth of its rms."""
    width = 0.1 * rms(x)
    return [np.tanh(c / width)[:, None] for c in x]


def rate(x: Array) -> Array:
    """Return the change since the sample before."""
    return np.diff(x, prepend=x[:1])


def rates(x: Sequence[Array]) -> list[Array]:
    """Return bent functions of the rate of change."""
    d = [rate(c) for c in x]
    size = rms(d)
    return [np.column_stack([(c / size) * np.abs(c / size), (c / size) ** 3, np.abs(c / size)]) for c in d]


def dynamics(x: Sequence[Array]) -> list[Array]:
    """Return the signal and its last two differences: what delay, lag and gain do to it, to second order."""
    parts: list[Callable[[Array], Array]] = [lambda c: c, rate, lambda c: rate(rate(c))]
    sizes = [rms([f(c) for c in x]) for f in parts]
    return [np.column_stack([f(c) / s for f, s in zip(parts, sizes, strict=True)]) for c in x]


def low_pass(x: Array, pole: float) -> Array:
    """Return the signal through a first-order low-pass."""
    return np.asarray(signal.lfilter([1 - pole], [1, -pole], x))


def plays(x: Sequence[Array]) -> list[Array]:
    """Return the signal through play operators of several radii: the building blocks of any hysteresis (Prandtl-Ishlinskii)."""
    size = rms(x)
    return [np.column_stack([_play(c, r * size) / size for r in RADII]) for c in x]


@njit(cache=True, nogil=True)
def _play(x, radius):  # type: ignore[no-untyped-def]
    """Return the play operator: the signal followed at a distance of at most ``radius``."""
    out = np.empty_like(x)
    at = 0.0
    for k, value in enumerate(x):
        at = min(max(at, value - radius), value + radius)
        out[k] = at
    return out


def clocks(lengths: Sequence[int]) -> list[Array]:
    """Return a level, a slope and a bend of its own for every run, zero in the others."""
    out = []
    for i, n in enumerate(lengths):
        t = np.arange(n) / n - 0.5
        columns = np.zeros((n, 3 * len(lengths)))
        columns[:, 3 * i : 3 * i + 3] = np.column_stack([np.ones(n), t, t**2 - 1 / 12])
        out.append(columns)
    return out
