"""A motor with measured speed, and an oscillator: simulated recordings whose gap is known."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from afdsvc.explain.gap.signals import ResidualSignals

NAMES = (["y"], ["u"], ["v"], [])


def coloured(n: int, time: float, rng: np.random.Generator, outputs: int = 1) -> np.ndarray:
    """Return stationary first-order noise of unit variance with this correlation time [samples]."""
    a = float(np.exp(-1 / time))
    return lfilter([np.sqrt(1 - a * a)], [1, -a], rng.normal(size=(n + int(10 * time), outputs)), axis=0)[-n:]


def steps(n: int, hold: int, rng: np.random.Generator) -> np.ndarray:
    """Return random levels, each held."""
    return np.repeat(rng.normal(size=n // hold + 1), hold)[:n, None]


def speed(u: np.ndarray, friction: float = 0.0, pole: float = 0.97) -> np.ndarray:
    """Return the speed ``(n, 1)`` of a motor with dry friction."""
    v = np.zeros(len(u))
    for t in range(1, len(u)):
        v[t] = pole * v[t - 1] + (1 - pole) * (u[t - 1, 0] - friction * np.tanh(50 * v[t - 1]))
    return v[:, None]


def motor(rng: np.random.Generator, n: int = 1500, friction: float = 0.0, noise: float = 0.1, time: float = 5.0, period: int = 0) -> ResidualSignals:
    """Return a recording of the motor against its simulation without friction."""
    u = steps(n, 40, rng) if not period else np.tile(steps(period, 40, rng), (n // period, 1))
    x = speed(u)
    return ResidualSignals(speed(u, friction) - x + noise * coloured(len(u), time, rng), u, x, np.zeros((len(u), 0)), 0.01, period)
