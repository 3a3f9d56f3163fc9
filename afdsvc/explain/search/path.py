"""Fits along the horizons, from a strong correction by the measurements to none (homotopy)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.search.fit import CONVERGED, ENOUGH, Coordinates, Fit, borrowed, column_counts, fit, rms, weighted
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.search.ranking import complexity, is_constant, mechanism
from afdsvc.explain.search.screen import Screened, Start, ends
from afdsvc.explain.simulate.effects import PlacedEffect

FINER = 4  # sub-steps of a sample that laws of lags and delays take
PARTS = 1.0, 0.25, 0.0625  # of what an effect promises at which its fit may begin
GLANCE, BRIEF = 2, 4  # iterations of every start, and of those that are best after them
Taus = Mapping[float, float]


def base_path(problem: Problem, horizons: Sequence[float], taus: Taus, start: Point, near: Mapping[float, Fit] | None = None) -> dict[float, Fit]:
    """Return the fits of a point along the horizons, each from the one before; at the last also from ``start``.

    Where fits of almost the same problem are at hand (``near``: samples counted or inputs interpolated otherwise), each begins there.
    """
    path: dict[float, Fit] = {}
    point, last = start, horizons[-1]
    for h in horizons:
        path[h] = fit(problem, near[h].point, h, taus[h], known=near[h].J) if near else fit(problem, point, h, taus[h])
        point = path[h].point
    again = fit(problem, start, last, taus[last]) if len(horizons) > 1 and not near else path[last]
    return path | {last: min(path[last], again, key=lambda f: f.cost)}


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A hypothesis after brief fits at the strongest and the weakest correction: the points, and the falls of the cost."""

    hypothesis: Hypothesis
    points: tuple[Point, ...]
    falls: tuple[float, ...]


def trial(problem: Problem, bases: Sequence[Mapping[float, Fit]], taus: Taus, screened: Mapping[float, Screened], starts: int) -> Trial:
    """Return the best of the starts after a few iterations at both ends of the horizons, from every base; falls are over the first."""
    base, points, falls = bases[0], [], []
    for h in ends(base):
        found = []
        for b in (b[h] for b in bases):
            begun = [_begin(problem, b, start, h) for start in screened[h].starts[:starts]]
            family = [fit(problem, p, h, taus[h], GLANCE * problem.effort, borrowed(problem, b, p, h), renewals=problem.effort - 1) for p in begun]
            first = min(family, key=lambda f: f.cost)
            found.append(fit(problem, first.point, h, taus[h], BRIEF * problem.effort, first.J, renewals=problem.effort, kept=column_counts(problem, b.point)))
        best = min(found, key=lambda f: f.cost)
        points.append(best.point)
        falls.append(base[h].cost - best.cost)
    return Trial(next(iter(screened.values())).hypothesis, tuple(points), tuple(falls))


def bases(problem: Problem, base: Mapping[float, Fit], taus: Taus) -> list[Mapping[float, Fit]]:
    """Return where trials begin: the base, and where it has bent the model's numbers beyond what its owner states, the stated ones, too."""
    bent = any(np.abs(base[h].point.theta).max(initial=0.0) > problem.settings.implausible for h in ends(base))
    stated = {h: fit(problem, replace(f.point, theta=np.zeros_like(f.point.theta)), h, taus[h], iterations=0) for h, f in base.items() if bent and h in ends(base)}
    return [base, stated] if bent else [base]


def _begin(problem: Problem, base: Fit, start: Start, horizon: float) -> Point:
    """Return the base with the effect, its free numbers shifted as the effect asks for or not, whichever costs less; where neither costs less
    than the base, with a part of both, for what is promised to first order holds over a part of the way."""
    c, effect, point = Coordinates(problem, base.point), start.effect, base.point
    linear = np.array([k.linear and k.free for k in effect.hypothesis.parameters], dtype=bool)
    for share in PARTS:
        less = replace(effect, values=np.where(linear, share * effect.values, effect.values))
        point = _nearer(problem, [base.point.added(less), c.unpack(c.pack(base.point) + share * start.shift).added(less)], horizon)
        if not linear.any() or _nearer(problem, [base.point, point], horizon) is point:
            break
    return point


def _nearer(problem: Problem, points: Sequence[Point], horizon: float) -> Point:
    """Return the point that leaves the smaller residual."""
    return min(points, key=lambda p: float(np.log(rms(weighted(problem, p, horizon))).sum()))


def added_path(problem: Problem, base: Mapping[float, Fit], taus: Taus, tried: Trial) -> dict[float, Fit]:
    """Return the fits with one more effect along the base's horizons, each from the one before; at the last from both ends of them, too.

    Their Jacobians are not exact.
    """
    *before, last = base

    def added(point: Point, h: float) -> Fit:
        if not problem.regular:  # the simulation of a plant that integrates bends more
            return fit(problem, point, h, taus[h], renewals=problem.effort)
        return fit(problem, point, h, taus[h], known=borrowed(problem, base[h], point, h), renewals=problem.effort, kept=column_counts(problem, base[h].point))

    path: dict[float, Fit] = {}
    point = tried.points[0]
    for h in before:
        path[h] = added(point, h)
        point = path[h].point
    starts = [point, tried.points[-1], path[before[0]].point] if before else [point]
    best = min((added(p, last) for p in starts), key=lambda f: f.cost)
    path[last] = fit(problem, best.point, last, taus[last], known=best.J, renewals=problem.effort)
    return path


def whole_path(problem: Problem, taus: Taus, rough: Mapping[float, Fit], base: Mapping[float, Fit] | None = None, enough: float = ENOUGH) -> dict[float, Fit]:
    """Return the fits to whole recordings that begin where those to their beginnings are, at the horizons that decide.

    ``base`` are fits to whole recordings without the last effect.
    """
    found = {}
    for h in ends(rough)[-1:] if problem.regular else ends(rough):
        same = rough[h].samples == sum(len(r) for r in problem.runs)
        known = borrowed(problem, base[h], rough[h].point, h) if base and problem.regular and not same else rough[h].J if same else None
        found[h] = fit(problem, rough[h].point, h, taus[h], known=known, renewals=None if known is None else problem.effort, enough=enough)
    return found


def resumed_path(problem: Problem, taus: Taus, path: Mapping[float, Fit]) -> dict[float, Fit]:
    """Return the fits of a path gone on with, samples counting by other correlation times."""
    return {h: fit(problem, f.point, h, taus[h], known=f.J, renewals=problem.effort) for h, f in path.items()}


def converged(problem: Problem, part: Problem, taus: Taus, path: Mapping[float, Fit], rough: Mapping[float, Fit]) -> tuple[dict[float, Fit], dict[float, Fit]]:
    """Return a path fitted to convergence, and its rough one, on a ``part`` of the recordings, with the same effects."""
    kept = {e.hypothesis.key for e in list(path.values())[-1].point.effects}
    fine = {h: fit(problem, f.point, h, taus[h], enough=CONVERGED) for h, f in path.items()}
    fitted = {}
    for h, f in rough.items():
        point = replace(f.point, effects=tuple(e for e in f.point.effects if e.hypothesis.key in kept))
        fitted[h] = fine[h] if part is problem and h in fine else fit(part, point, h, taus[h])
    return fine, fitted


def refined(problem: Problem, part: Problem, taus: Taus, path: Mapping[float, Fit], rough: Mapping[float, Fit]) -> tuple[dict[float, Fit], dict[float, Fit]]:
    """Return a path and its rough one in the finer steps of a problem: from the strongest correction on, each fit begins where it was or where
    the one before it ended, for laws of contact have many minima."""
    fitted: dict[float, Fit] = {}
    for h, f in rough.items():
        fitted[h] = fit(part, _nearer(part, [f.point, *(g.point for g in list(fitted.values())[-1:])], h), h, taus[h])
    return {h: fit(problem, _nearer(problem, [f.point, fitted[h].point], h), h, taus[h], enough=CONVERGED) for h, f in path.items()}, fitted


def coarse(problem: Problem, path: Mapping[float, Fit]) -> bool:
    """Whether finer steps change a path by what is asked of a further effect: in likelihood, and as a share of the power that it leaves."""
    (last, f), s = list(path.items())[-1], problem.settings
    change = np.log(rms(weighted(replace(problem, substeps=max(FINER, problem.substeps)), f.point, last)) / f.sd)
    return bool(2 * f.samples * abs(change.sum()) > s.evidence * f.own_tau and (np.abs(np.expm1(2 * change)) > s.further).any())


def fewer_path(problem: Problem, path: Mapping[float, Fit], taus: Taus, left_out: int) -> dict[float, Fit]:
    """Return the refits of a path without one of its effects."""
    found = {}
    for h, f in path.items():
        effects = tuple(e for k, e in enumerate(f.point.effects) if k != left_out)
        found[h] = fit(problem, replace(f.point, effects=effects), h, taus[h])
    return found


def exchanged_path(problem: Problem, taus: Taus, fewer: Mapping[float, Fit], path: Mapping[float, Fit], effect: PlacedEffect) -> dict[float, Fit]:
    """Return the fits of ``fewer`` with an effect added; numbers of the model begin as there or as in ``path``."""
    found = {}
    for h, f in fewer.items():
        points = [f.point.added(effect), replace(f.point, theta=path[h].point.theta).added(effect)]
        found[h] = fit(problem, _nearer(problem, points, h), h, taus[h], enough=CONVERGED)
    return found


def promising(tried: Sequence[Trial], count: int, likely: float) -> list[Trial]:
    """Return the trials that fell most at the weakest correction and those within chance of the first, half as many more of those that did
    at the strongest, and of every mechanism among them the simplest shape. The first of ``count`` different laws or places are among them, too: shapes
    of one do not crowd out others."""
    ordered = sorted(tried, key=lambda t: -t.falls[-1])
    laws = dict.fromkeys((t.hypothesis.physics, t.hypothesis.site) for t in ordered)
    first = [*ordered[:count], *(next(t for t in ordered if (t.hypothesis.physics, t.hypothesis.site) == law) for law in [*laws][:count])]
    chosen = [t for t in ordered if t in first or 2 * (ordered[0].falls[-1] - t.falls[-1]) < likely]
    chosen += [t for t in sorted(tried, key=lambda t: -t.falls[0])[:count] if t not in chosen][: count // 2]
    for kind in {mechanism(t.hypothesis): None for t in chosen}:
        shapes = [t for t in tried if mechanism(t.hypothesis) == kind]
        chosen.append(min(shapes, key=lambda t: (complexity(t.hypothesis), -t.falls[-1])))
    return list(dict.fromkeys(chosen))


def kept_promises(base: dict[float, Fit], paths: Sequence[dict[float, Fit]], share: float, limited: str) -> list[dict[float, Fit]]:
    """Return the paths whose fall of the cost is a share of the largest one, at the strongest or the weakest correction,
    and the first of two mechanisms in any case: how far behind the second is says how sure the first is.

    Where the model limits, constants that are off do not set the measure: with physics left out any fit moves them.
    """
    last = [list(path.values())[-1].point.effects[-1].hypothesis for path in paths]
    measure = [limited == "noise" or not is_constant(h) for h in last]
    falls = np.array([[base[h].cost - path[h].cost for h in ends(base)] for path in paths]).reshape(len(paths), len(ends(base)))
    best = falls[measure if any(measure) else slice(None)].max(axis=0, initial=0.0)
    kinds = [mechanism(h) for h in last]
    second = max((fall for fall, kind in zip(falls[:, -1], kinds, strict=True) if kind != kinds[int(falls[:, -1].argmax())]), default=np.inf)
    return [path for path, fall in zip(paths, falls, strict=True) if (fall >= share * best).any() or fall[-1] >= second]
