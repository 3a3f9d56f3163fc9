"""The model refitted without effects: what every hypothesis is compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.explain.noise.weighting import Weighting, correlation_time, own, weighting
from afdsvc.explain.search.build import growth
from afdsvc.explain.search.fit import CONVERGED, Fit, fit
from afdsvc.explain.search.path import base_path, whole_path
from afdsvc.explain.search.problem import LOST, Problem
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The problem with its weighting; the correlation times by horizon, and the model refitted without effects.

    ``start`` has the fits to whole recordings at the horizons that decide, ``rough`` those to a ``part`` of them, their beginnings or what shows more,
    at every horizon. ``limited`` says what limits how well the recordings are followed: "noise" or "model".
    """

    problem: Problem
    part: Problem
    taus: dict[float, float]
    start: dict[float, Fit]
    rough: dict[float, Fit]
    limited: str


def settled(problem: Problem, choose: bool = True) -> Settled:
    """Return the problem with its weighting, correlation times and horizons, and the model refitted without effects.

    Unless it is to ``choose`` whether inputs are held between samples or smooth, they are as in the problem.
    """
    s = problem.settings
    part, path = _interpolated(problem.beginning(), choose)
    problem = replace(problem, ramped=part.ramped) if part is not problem else part
    taus = {h: f.own_tau for h, f in path.items()}
    path = base_path(part, s.horizons, taus, part.start(), path)
    path = {h: path[h] for h in _horizons(part, path)}
    start = whole_path(problem, taus, path)
    last = list(path)[-1]
    part = part if part is problem else _shown(problem, part, start[last], last)
    w = weighting(problem.runs, problem.residuals(start[last].point, last))
    limited = "model"
    white = correlation_time([w(e) for e in problem.residuals(start[last].point, last)]) * s.independent < start[last].samples
    if not w.even and white and np.max(start[last].sd**2 / w.floor) < s.noise_limited:
        limited = "noise"
        begin = replace(start[last].point, offset=np.zeros(len(problem.scale)), effects=())  # offsets and loads are hypotheses here
        part, problem = _weighted(part, w), _weighted(problem, w)
        taus = {last: 1.0}
        for _ in range(2):
            path = base_path(part, (last,), taus, begin)
            taus = {last: path[last].own_tau}
    else:
        taus = {h: start.get(h, f).own_tau for h, f in path.items()}
        path = base_path(part, list(path), taus, part.start(), path)
    return Settled(problem, part, taus, whole_path(problem, taus, path), path, limited)


def _shown(problem: Problem, part: Problem, f: Fit, horizon: float) -> Problem:
    """Return the part of the recordings that hypotheses are chosen on: the beginnings, or where they hold less than `Settings.shown` of their share
    of the motion, or of what the fit to whole recordings misses, the stretches of the same lengths that hold most of both."""
    simulated = problem.simulated(f.point, horizon)
    spread = np.maximum(np.vstack([s.y for s in simulated]).std(0), 1e-300)
    pairs = [(e / f.sd, s.y / spread) for e, s in zip(f.residuals, simulated, strict=True)]
    held = [np.stack([_powers(x, len(r)) for x in pair]) for r, pair in zip(part.runs, pairs, strict=True)]
    whole = np.sum([[float(_powers(x, len(x))[0]) for x in pair] for pair in pairs], axis=0) + 1e-300
    if (sum(h[:, 0] for h in held) * f.samples >= problem.settings.shown * whole * sum(len(r) for r in part.runs)).all():
        return part
    begins = [int(np.argmax(h.T @ (1 / whole))) for h in held]
    stretches = [(r.span(k, k + len(p)), s.x[k]) for r, p, s, k in zip(problem.runs, part.runs, simulated, begins, strict=True)]
    return problem.of(*zip(*stretches, strict=True))


def _powers(x: Array, n: int) -> Array:
    """Return the sum of squares about the mean of every stretch of ``n`` samples, all outputs together; ``x (samples, p)``."""
    first, second = (np.vstack([np.zeros(x.shape[1]), np.cumsum(v, axis=0)]) for v in (x - x.mean(0), (x - x.mean(0)) ** 2))
    sums, squares = (c[n:] - c[: len(c) - n] for c in (first, second))
    return np.asarray((squares - sums**2 / n).sum(1))


def under_slow_noise(settled: Settled, noise: Array) -> Settled:
    """Return the same problem with residuals divided by their own spectrum, and the model refitted; ``noise (p,)`` as in `own`."""
    (last, f), found = list(settled.start.items())[-1], settled
    for _ in range(2):
        w = own(settled.problem.residuals(f.point, last), noise)
        part, problem = replace(settled.part, weighting=w), replace(settled.problem, weighting=w)
        rough = base_path(part, (last,), {last: 1.0}, f.point)
        taus = {last: rough[last].own_tau}
        start = whole_path(problem, taus, rough)
        found, f = replace(settled, problem=problem, part=part, taus=taus, start=start, rough=rough), start[last]
    return found


def _weighted(problem: Problem, w: Weighting) -> Problem:
    """Return the problem where noise limits, whose noise is known apart from the model."""
    return replace(problem, weighting=w, settings=replace(problem.settings, theta_sd=1.0), offset_free=False, loads=())


def _interpolated(problem: Problem, choose: bool) -> tuple[Problem, dict[float, Fit]]:
    """Return the problem as it is, or with smooth inputs where it may choose them and they follow the recordings better."""
    taus = dict.fromkeys(problem.settings.horizons, 1.0)
    as_is = problem, base_path(problem, problem.settings.horizons, taus, problem.start())
    if not (choose and may_be_smooth(problem)):
        return as_is
    smooth = replace(problem, ramped=True)
    other = smooth, base_path(smooth, problem.settings.horizons, taus, problem.start(), as_is[1])
    return min(as_is, other, key=lambda pair: sum(f.deviance for f in pair[1].values()))


def may_be_smooth(problem: Problem) -> bool:
    """Whether inputs may run smoothly between samples: no controller or command that holds them is known, and they are no staircase."""
    plant = problem.nominal.plant
    driven = any(r.W is not None or r.commanded or bool(np.ptp(r.REF, axis=0).max(initial=0.0) > 0) for r in problem.runs)
    held = bool(plant.inputs) and np.median(np.concatenate([np.abs(np.diff(r.U, axis=0)).max(1) for r in problem.runs])) == 0  # a staircase
    return not (plant.discrete or not plant.inputs or problem.nominal.model.controller is not None or driven or held)


def otherwise_between(problem: Problem, path: dict[float, Fit]) -> Problem | None:
    """Return the problem with inputs held instead of smooth between samples, or the other way round, if a path gains by that what is asked of any effect."""
    if not (problem.weighting.even and may_be_smooth(problem)):
        return None
    other, (last, f) = replace(problem, ramped=not problem.ramped), list(path.items())[-1]
    gain = (f.deviance - fit(other, f.point, last, f.tau, enough=CONVERGED).deviance) / f.own_tau
    return other if gain > problem.settings.evidence else None


def _horizons(problem: Problem, path: dict[float, Fit]) -> tuple[float, ...]:
    """Return the horizons down to the decision horizon: simulation for a plant that forgets, else the weakest that follows.

    A simulation in which an error of a thousandth grows to the size of the output follows nothing but its initial state.
    """
    horizons = problem.settings.horizons
    if problem.regular:
        return horizons
    grows = growth(problem.nominal) ** max(len(r) for r in problem.runs) > LOST
    follows = [h for h in horizons if (h or not grows) and float(np.sqrt(np.mean(path[h].sd**2))) < problem.settings.drift_limit]
    return horizons[: horizons.index(follows[-1]) + 1] if follows else horizons[:1]
