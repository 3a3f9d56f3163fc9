"""What a feature is: columns made of the scaled signals, the groups they depend on, and the first tier that uses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from afdsvc.explain.gap.signals import ResidualSignals
from afdsvc.lti.statespace import Array

LINEAR, STATIC, ALL = 0, 1, 2
Groups = frozenset[str]
Function = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """Columns ``make(z)`` of the scaled signals ``z (n, d)``, shape ``(n,)`` or ``(n, c)``."""

    make: Function
    groups: Groups
    tier: int


@dataclass(frozen=True, slots=True, eq=False)
class Dictionary:
    """Features with centre and scale of the signals they are made of."""

    features: tuple[Feature, ...]
    centre: Array
    scale: Array

    def columns(self, recording: ResidualSignals, feature: Feature) -> Array:
        """Return the feature's columns ``(n, c)``, less their mean over the recording."""
        made = feature.make((recording.columns - self.centre) / self.scale)
        out = made if made.ndim == 2 else made[:, None]
        return np.asarray(out - out.mean(0))


@dataclass(frozen=True, slots=True)
class SignalColumn:
    """A signal: its column, whether it is an input, a state or aux, its name."""

    column: int
    kind: str
    name: str

    @property
    def now(self) -> Groups:
        """What a function of its present value depends on."""
        return frozenset(["inputs"] if self.kind == "input" else [f"{self.kind} {self.name}"])

    @property
    def past(self) -> Groups:
        """What a function of its past depends on."""
        return frozenset(["input history"]) if self.kind == "input" else self.now

    def of(self, function: Function) -> Function:
        """Return ``function`` of this signal as a function of all."""
        return lambda z: function(z[:, self.column])


def hinge(x: Array, knot: float) -> Array:
    """Return ``max(0, x - knot)``."""
    return np.maximum(0.0, x - knot)


def odd_square(x: Array) -> Array:
    """Return ``x |x|``."""
    return np.asarray(x * np.abs(x))


def cube(x: Array) -> Array:
    """Return ``x^3``, held beyond 4 standard deviations."""
    return np.asarray(np.clip(x, -4.0, 4.0) ** 3)


def sign(x: Array) -> Array:
    """Return the sign, and a smooth one, a quarter of a standard deviation wide: ``(n, 2)``."""
    return np.column_stack([np.sign(x), np.tanh(4 * x)])


def turns(x: Array, radians: float) -> Array:
    """Return cosine and sine of an angle and of twice the angle ``(n, 4)``; ``x`` is in units of ``radians``."""
    return np.column_stack([f(k * radians * x) for k in (1, 2) for f in (np.cos, np.sin)])


def pair_product(z: Array, a: int, b: int) -> Array:
    """Return the product of two signals."""
    return np.asarray(z[:, a] * z[:, b])


def through(z: Array, function: Function, pole: complex) -> Array:
    """Return the first column of a function of all signals through a pole."""
    return resonate(function(z).reshape(len(z), -1)[:, 0], pole)


def wave(z: Array, past: Sequence[tuple[int, int]], weights: Array, phase: float) -> Array:
    """Return the cosine of a weighted sum of signals, each (column, lag)."""
    parts = [w * shifted(z[:, column], k) for w, (column, k) in zip(weights, past, strict=True)]
    return np.asarray(np.cos(phase + np.sum(parts, axis=0)))


def time(z: Array) -> Array:
    """Return the first three Legendre polynomials over the recording."""
    return np.asarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(z)), 3)[:, 1:])


def shifted(z: Array, k: int) -> Array:
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
