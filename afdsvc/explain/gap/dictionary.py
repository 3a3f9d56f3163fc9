"""The features of the flexible model: functions of inputs, simulated states, aux and time, in three nested tiers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.random import Generator

from afdsvc.explain.gap import features as make
from afdsvc.explain.gap.features import (
    ALL,
    LINEAR,
    STATIC,
    Dictionary,
    Feature,
    Function,
    SignalColumn,
    first_order_lag,
    level,
    mode_pole,
    poles,
    resonate,
    shifted,
)
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import Names, ResidualSignals
from afdsvc.lti.statespace import Array

T = TypeVar("T")
CURVED = frozenset(["amplitude"])


def dictionary(recordings: Sequence[ResidualSignals], names: Names, rng: Generator, settings: GapSettings) -> Dictionary:
    """Return the dictionary for these recordings; signals that do not move are left out."""
    pool = np.vstack([r.columns for r in recordings])
    mean, sd = pool.mean(0), pool.std(0)
    centre = np.where(np.abs(mean) > 3 * sd, mean, 0.0)  # zero keeps its meaning where the signal comes near it
    moving = sd > 1e-9 * np.abs(pool).max(0, initial=0.0)
    scale = np.where(moving, sd, 1.0)
    kinds = [(kind, name) for kind, group in zip(("input", "state", "aux"), names[1:], strict=True) for name in group]
    sources = [SignalColumn(i, kind, name) for i, (kind, name) in enumerate(kinds) if moving[i]]
    builder = Builder(sources, (pool - centre) / scale, scale, poles(recordings), max(map(len, recordings)), rng, settings)
    return Dictionary(tuple(builder.features()), centre, scale)


class Builder:
    """Builds the features of each kind; ``z (n, d)`` are all scaled signals, ``longest`` samples in a recording."""

    def __init__(
        self, sources: list[SignalColumn], z: Array, scale: Array, poles: list[complex], longest: int, rng: Generator, settings: GapSettings
    ) -> None:
        self.sources, self.z, self.scale, self.poles, self.longest = sources, z, scale, poles, longest
        self.rng, self.settings = rng, settings
        self.inputs = [s for s in sources if s.kind == "input"]
        self.constants = [float(v) for v in np.geomspace(4, max(longest / 10, 8), 4)]

    def features(self) -> list[Feature]:
        """Return all features."""
        static = [f for s in self.sources for f in self.curves(s)] + self.products()
        levels = [Feature(s.of(partial(level, samples=self.constants[1])), s.past | CURVED, ALL) for s in self.sources]
        return [*self.linear(), *static, *self.filtered(static), *self.waves(), *levels, Feature(make.time, frozenset(["time"]), ALL)]

    def linear(self) -> list[Feature]:
        """Return present values, lags, low-pass filters, resonances of the simulation and others."""
        now = [Feature(s.of(np.asarray), s.now, LINEAR) for s in self.sources]
        lags: list[tuple[SignalColumn, Function]] = [(s, partial(shifted, k=k)) for s in self.inputs or self.sources for k in (1, 2, 4, 8, 16)]
        lows: list[tuple[SignalColumn, Function]] = self.draw([(s, partial(first_order_lag, samples=c)) for s in self.sources for c in self.constants], 4)
        ours: list[tuple[SignalColumn, Function]] = self.draw([(s, partial(resonate, pole=q)) for s in self.sources for q in self.poles], 4)
        count = max(3, self.settings.bank // (4 * max(1, len(self.inputs))))
        modes = [mode_pole(float(f), d) for f in np.geomspace(4 / self.longest, 0.45, count) for d in self.settings.damping]
        others: list[tuple[SignalColumn, Function]] = [(s, partial(resonate, pole=q)) for s in self.inputs for q in modes]
        return now + [Feature(s.of(f), s.past, LINEAR) for s, f in lags + lows + ours + others]

    def curves(self, s: SignalColumn) -> list[Feature]:
        """Return nonlinear functions of one signal's present value."""
        count = int(np.clip(self.settings.knots // len(self.sources), 2, 7))
        knots = np.quantile(self.z[:, s.column], np.linspace(0.05, 0.95, count))
        curves: list[Function] = [*(partial(make.hinge, knot=float(q)) for q in knots), make.odd_square, make.cube]
        signs = Feature(s.of(make.sign), s.now | {f"sign of {s.name}"}, STATIC)
        angle = [partial(make.turns, radians=float(self.scale[s.column]))] if s.kind == "aux" and "angle" in s.name else []
        return [*(Feature(s.of(f), s.now | CURVED, STATIC) for f in curves), signs, *(Feature(s.of(f), s.now, STATIC) for f in angle)]

    def products(self) -> list[Feature]:
        """Return products of two signals."""
        pairs = self.draw([(a, b) for i, a in enumerate(self.sources) for b in self.sources[:i]], 3)
        return [Feature(partial(make.pair_product, a=a.column, b=b.column), a.now | b.now | CURVED, STATIC) for a, b in pairs]

    def filtered(self, static: list[Feature]) -> list[Feature]:
        """Return nonlinear functions through the poles of the simulation: what a force or an input law does to an output."""
        pairs = self.draw([(f, q) for f in static for q in self.poles or [0.9 + 0j]], 1 + any(q.imag for q in self.poles))
        return [Feature(partial(make.through, function=f.make, pole=q), f.groups, ALL) for f, q in pairs]

    def waves(self) -> list[Feature]:
        """Return random Fourier features of up to three signals or their recent past."""
        past = [(s, k) for s in self.sources for k in ((0, 1, 4, 16) if s.kind == "input" else (0,))]
        return [self.wave(self.drawn(past, 3)) for _ in range(self.settings.picked // 2 if past else 0)]

    def wave(self, chosen: list[tuple[SignalColumn, int]]) -> Feature:
        """Return the wave of these signals and lags."""
        groups = CURVED.union(*(s.past if k else s.now for s, k in chosen))
        past = [(s.column, k) for s, k in chosen]
        weights, phase = self.rng.normal(size=len(chosen)), float(self.rng.uniform(0, 2 * np.pi))
        return Feature(partial(make.wave, past=past, weights=weights, phase=phase), groups, ALL)

    def draw(self, of: list[T], parts: int) -> list[T]:
        """Return at most the settings' number of picks over ``parts``."""
        return self.drawn(of, self.settings.picked // parts)

    def drawn(self, of: list[T], most: int) -> list[T]:
        """Return at most so many, drawn at random, in their order."""
        return of if len(of) <= most else [of[i] for i in sorted(self.rng.choice(len(of), most, replace=False))]
