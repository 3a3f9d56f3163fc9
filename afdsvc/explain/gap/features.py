"""What a feature is: columns made of the scaled signals, the groups they depend on, and the first tier that uses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from afdsvc.explain.gap.filters import lagged, resonate
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
        return partial(_of_column, function=function, column=self.column)


def _of_column(z: Array, function: Function, column: int) -> Array:
    return function(z[:, column])


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
    parts = [w * lagged(z[:, column], k) for w, (column, k) in zip(weights, past, strict=True)]
    return np.asarray(np.cos(phase + np.sum(parts, axis=0)))


def time(z: Array) -> Array:
    """Return the first three Legendre polynomials over the recording."""
    return np.asarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(z)), 3)[:, 1:])
