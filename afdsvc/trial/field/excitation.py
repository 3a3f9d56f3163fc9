"""Excitation of the field trials, each of unit size for a machine that takes ``tau`` seconds: half of the kinds never repeat."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array

Generator = np.random.Generator
REPEATING = ("multisine", "periods")
ONCE = ("staircase", "aprbs", "steps", "chirp", "operation", "random", "relay")


def staircase(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return levels up and down again in even steps of 1.5 to 4 times tau, one way only half of the time."""
    hold, count = max(2, round(g.uniform(1.5, 4.0) * tau / dt)), int(g.integers(4, 9))
    up = np.linspace(0.0 if g.random() < 0.5 else -1.0, 1.0, count)
    levels = np.concatenate([up, up[-2:0:-1]])
    return np.asarray(levels[(np.arange(n) // hold) % levels.size])


def aprbs(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return random levels held for random times of 0.3 to 4 times tau."""
    return _held(n, dt, tau, g, 0.3, 4.0)


def steps(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a few large steps to random levels of either sign, 4 to 8 times tau apart."""
    levels = _held(n, dt, tau, g, 4.0, 8.0)
    return np.where(levels < 0, -0.4, 0.4) + 0.6 * levels


def _held(n: int, dt: float, tau: float, g: Generator, low: float, high: float) -> Array:
    out, k = np.zeros(n), 0
    while k < n:
        length = max(2, round(g.uniform(low, high) * tau / dt))
        out[k : k + length] = g.uniform(-1.0, 1.0)
        k += length
    return out


def chirp(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a sine whose frequency grows from 0.03 / tau to about 1.5 / tau by a constant factor per second."""
    t, low, high = np.arange(n) * dt, 0.03 / tau, g.uniform(0.8, 2.0) / tau
    rate = np.log(high / low) / (n * dt)
    return np.asarray(np.sin(2 * np.pi * low * np.expm1(rate * t) / rate + g.uniform(0, 2 * np.pi)))


def operation(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return smooth moves to random places with rests between, as a production program makes them."""
    out, k, place = np.zeros(n), 0, 0.0
    while k < n:
        move, rest = (max(2, round(g.uniform(a, b) * tau / dt)) for a, b in ((0.8, 3.0), (0.2, 3.0)))
        target, s = float(g.uniform(-1.0, 1.0)), np.minimum(np.arange(1, move + rest + 1) / move, 1.0)
        part = place + (target - place) * s**3 * (10 - 15 * s + 6 * s * s)
        out[k : k + part.size] = part[: n - k]
        place, k = target, k + part.size
    return out


def random(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return filtered noise with a correlation time of 0.1 to 0.6 times tau, held to +-1."""
    pole = np.exp(-dt / (g.uniform(0.1, 0.6) * tau))
    x = lfilter([np.sqrt(1 - pole * pole)], [1.0, -pole], g.standard_normal(n))
    return np.clip(0.45 * np.asarray(x), -1.0, 1.0)


def relay(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return the size of a relay's output, which the machine itself switches, changed now and then."""
    return 0.6 + 0.4 * np.abs(_held(n, dt, tau, g, 10.0, 30.0))


def multisine(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a multisine of random phases below 1.2 / tau that repeats three to six times."""
    period = n // int(g.integers(3, 7))
    lines = np.arange(1, max(4, int(1.2 / tau * period * dt)))
    lines = g.choice(lines, min(lines.size, 40), replace=False)
    phases = g.uniform(0, 2 * np.pi, lines.size)
    x = np.cos(2 * np.pi / period * np.outer(np.arange(period), lines) + phases).sum(axis=1)
    return np.asarray(np.resize(x / np.abs(x).max(), n))


def periods(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a random level sequence that repeats three to six times."""
    period = n // int(g.integers(3, 7))
    return np.resize(aprbs(period, dt, tau, g), n)


SHAPES = {shape.__name__: shape for shape in (staircase, aprbs, steps, chirp, operation, random, relay, multisine, periods)}
