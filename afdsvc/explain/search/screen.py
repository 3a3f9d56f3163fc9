"""The linear screen: what a hypothesis could gain with everything else free to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.noise.surrogates import chance
from afdsvc.explain.noise.weighting import differing
from afdsvc.explain.search.fit import STEP, Coordinates, Fit, weighted
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.settings import Mapper
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a fit may begin: the effect, the fall of the cost it promises, the direction in the scaled residual that no free number
    imitates, and the shift of the base's coordinates that goes with it."""

    effect: PlacedEffect
    fall: float
    direction: Array
    shift: Array


@dataclass(frozen=True, slots=True, eq=False)
class Screened:
    """A hypothesis with its starts, best first."""

    hypothesis: Hypothesis
    starts: tuple[Start, ...]

    @property
    def fall(self) -> float:
        """What the best start promises."""
        return self.starts[0].fall


class Screen:
    """Projects what an effect changes on what the free numbers of a fit cannot imitate.

    At the optimum of the base the cost falls along an effect as if nothing else moved; what else moves enters its curvature only.
    """

    def __init__(self, problem: Problem, base: Fit, horizon: float) -> None:
        self.problem, self.base, self.horizon = problem, base, horizon
        self.scale = np.concatenate([np.tile(1 / (base.sd * np.sqrt(base.tau)), len(e)) for e in base.residuals])
        self.J = base.J * self.scale[:, None]
        self.e = np.concatenate([r.ravel() for r in base.residuals]) * self.scale

    def __call__(self, hypothesis: Hypothesis) -> Screened:
        """Return the hypothesis with its starts ordered by what they promise.

        A law that begins in place of a part of the model also begins at the stated numbers, for the base has bent them in its absence.
        """
        given = [np.array(s, float) for s in hypothesis.starts]
        tried = [self._start(hypothesis, values) for values in given]
        tried += [self._stated(hypothesis, values) for values in given if any(v for v, c in zip(values, hypothesis.parameters, strict=True) if c.linear and c.free)]
        return Screened(hypothesis, tuple(sorted(tried, key=lambda t: -t.fall)))

    def shift(self, change: Array) -> Array:
        """Return the shift of the free numbers that answers a change of the residual best (prior included)."""
        return np.asarray(-np.linalg.solve(self.base.H, self.J.T @ change))

    def change(self, effect: PlacedEffect) -> Array:
        """Return what an effect changes in the weighted residual."""
        there = weighted(self.problem, self.base.point.added(effect), self.horizon)
        return np.asarray(np.concatenate([(b - a).ravel() for a, b in zip(self.base.residuals, there, strict=True)]) * self.scale)

    def _start(self, h: Hypothesis, values: Array) -> Start:
        if h.lasting:
            return self._beginnings(h, values)
        linear = [j for j, c in enumerate(h.parameters) if c.linear and c.free]
        if not linear:
            return self._along(h, values)
        # They move as far as the free numbers do in `fit`: over their whole scale the response of a lightly damped machine curves, which hides what those imitate.
        units = STEP * np.array([values[j] or h.parameters[j].scale for j in linear])
        return self._amplitudes(h, values, linear, units)

    def _stated(self, h: Hypothesis, values: Array) -> Start:
        """Return the start at the stated numbers of the model, and what it leaves less than the base."""
        c, effect = Coordinates(self.problem, self.base.point), PlacedEffect(h, values)
        there = replace(self.base.point, theta=np.zeros_like(self.base.point.theta))
        e = np.concatenate([r.ravel() for r in weighted(self.problem, there.added(effect), self.horizon)]) * self.scale
        fall = float(self.e @ self.e - e @ e)
        return Start(effect, fall if np.isfinite(fall) else -np.inf, np.nan_to_num(self.e - e), c.pack(there) - c.pack(self.base.point))

    def _along(self, h: Hypothesis, values: Array) -> Start:
        """Return the start for a change of fixed shape, as if its size were free between none and a little more than it is."""
        d = self.change(PlacedEffect(h, values))
        shift = self.shift(d)
        r = d + self.J @ shift
        power, along = float(r @ d), float(d @ self.e)
        factor = min(max(-along / power, 0.0), 1.2) if power > 0 else 0.0
        return Start(PlacedEffect(h, values), -(2 * factor * along + factor**2 * power), r, shift)

    def _beginnings(self, h: Hypothesis, values: Array) -> Start:
        """Return the start with the best beginning of a memory that lasts, for every recording."""
        lengths, size = [e.size for e in self.base.residuals], self.problem.size(h.reads[0])
        rows = np.repeat(np.arange(len(lengths)), lengths)
        cells = size * np.eye(h.unsettled)
        changes = [self.change(PlacedEffect(h, values, (cell,) * len(lengths))) for cell in cells]
        columns = [np.where(rows == r, d, 0.0) for r in range(len(lengths)) for d in changes]
        D, shifts, G, g, a = self._best(columns)
        begun = tuple(cells.T @ part for part in a.reshape(len(lengths), h.unsettled))
        return Start(PlacedEffect(h, values, begun), -float(2 * a @ g + a @ G @ a), D @ a + self.J @ (shifts @ a), shifts @ a)

    def _amplitudes(self, h: Hypothesis, values: Array, linear: Sequence[int], units: Array) -> Start:
        """Return the start with the best amplitudes of the parameters a law is proportional to, by a step of one unit in each."""
        columns = []
        for j, unit in zip(linear, units, strict=True):
            moved = values.copy()
            moved[j] = unit
            columns.append(self.change(PlacedEffect(h, moved)))
        D, shifts, G, g, a = self._best(columns)
        limits = [(h.parameters[j].low, h.parameters[j].high) for j in linear]
        found = values.copy()
        found[linear] = [min(max(unit * factor, low), high) for unit, factor, (low, high) in zip(units, a, limits, strict=True)]
        size = found[linear] / units
        return Start(PlacedEffect(h, found), -float(2 * size @ g + size @ G @ size), D @ size + self.J @ (shifts @ size), shifts @ size)

    def _best(self, columns: Sequence[Array]) -> tuple[Array, Array, Array, Array, Array]:
        """Return changes, the shifts that answer them, curvature and slope of the cost along them, and their best sizes."""
        D = np.column_stack(columns)
        shifts = np.column_stack([self.shift(d) for d in columns])
        G, g = (D + self.J @ shifts).T @ D, D.T @ self.e
        return D, shifts, G, g, -np.linalg.lstsq(G + 1e-12 * np.trace(G) * np.eye(len(G)), g, rcond=1e-12)[0]


def ends(path: Mapping[float, Fit]) -> list[float]:
    """Return the strongest and the weakest correction of a path, one where they are the same."""
    horizons = list(path)
    return list(dict.fromkeys([horizons[0], horizons[-1]]))


def shortlist(
    problem: Problem, path: dict[float, Fit], offered: Sequence[Hypothesis], mappers: Sequence[Mapper], count: int
) -> tuple[list[dict[float, Screened]], dict[float, float]]:
    """Return the ``count`` hypotheses that promise most at the strongest or the weakest correction, and what chance promises there.

    ``mappers`` are one for each of these ends. What chance promises is the largest gain of any hypothesis, to first order, that is expected on surrogates of the residual.
    """
    found: dict[str, dict[float, Screened]] = {}
    chosen: list[str] = []
    by_chance: dict[float, float] = {}
    for h, mapper in zip(ends(path), mappers, strict=False):
        screen = Screen(problem, path[h], h)
        screened = sorted(mapper(screen, offered), key=lambda x: -x.fall)
        for x in screened:
            found.setdefault(x.hypothesis.key, {})[h] = x
        chosen += [x.hypothesis.key for x in screened[:count]]
        directions = np.array([x.starts[0].direction for x in screened]).reshape(len(screened), len(screen.scale))
        rng = np.random.default_rng(len(offered))
        by_chance[h] = 2 * chance(_noise(problem, path[h]), [len(r) for r in problem.runs], directions, screen.scale, problem.settings.surrogates, rng)
    return [found[k] for k in dict.fromkeys(chosen)], by_chance


def _noise(problem: Problem, base: Fit) -> list[Array]:
    """Return the noise of every run: what differs between periods of the residual where noise limits, else the residual."""
    if problem.weighting.even:
        return list(base.residuals)
    noise = [differing(r, e) for r, e in zip(problem.runs, base.residuals, strict=True)]
    return [e if d is None else d for d, e in zip(noise, base.residuals, strict=True)]
