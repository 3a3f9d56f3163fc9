"""The recordings beside the simulations, before and after, and how well these fit what was held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.report.explanation import Course, OutputFit
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.heldout import on, played
from afdsvc.explain.search.problem import Point, Problem, loop_known
from afdsvc.lti.statespace import Array
from afdsvc.stats.portmanteau import whiteness

WAYS = ("from the inputs", "in closed loop", "predicted")


@dataclass(frozen=True, slots=True, eq=False)
class Player:
    """Plays a model over recordings: ``way`` is one of `WAYS`; only initial states are fitted."""

    problem: Problem
    way: str
    horizon: float

    def outputs(self, runs: Sequence[Run], point: Point) -> list[Array]:
        """Return the simulated outputs ``(n, p)`` of every run, from the initial state that fits it best."""
        there = on(self.problem, runs)
        return played(there, replace(point, x0=there.x0), self.horizon)[0]

    def nrmse(self, runs: Sequence[Run], point: Point) -> Array:
        """Return ``|y - yhat| / |y - mean|`` of every output over all runs, ``(p,)``; infinite where a simulation left."""
        return nrmse(np.vstack([r.Y for r in runs]), np.vstack(self.outputs(runs, point)))


def player(found: Found) -> Player:
    """Return the way to play: from the inputs where the search could, else in closed loop where that is known, else predicted."""
    problem, last = found.problem, list(found.end)[-1]
    if last == 0.0:
        return Player(problem, WAYS[problem.closed], 0.0)
    if loop_known(problem):
        return Player(replace(problem, closed=True), WAYS[1], 0.0)
    return Player(problem, WAYS[2], last)


def courses(player: Player, runs: Sequence[Run], role: str, before: Point, after: Point) -> tuple[Course, ...]:
    """Return the recordings beside the simulations of both models."""
    both = (player.outputs(runs, p) for p in (before, after))
    return tuple(Course(r.name, role, _time(r), r.Y, b, a) for r, b, a in zip(runs, *both, strict=True))


def _time(run: Run) -> Array:
    return np.asarray(run.t0 + run.dt * np.arange(len(run)), dtype=np.float64)


def fits(held: Sequence[Course], names: Sequence[str], floor: Sequence[float] | None) -> tuple[OutputFit, ...]:
    """Return the errors of every output on the held-out recordings, and the noise's."""
    y, before, after = (np.vstack([getattr(c, k) for c in held]) for k in ("measured", "before", "after"))
    errors = zip(names, nrmse(y, before), nrmse(y, after), strict=True)
    spread = np.maximum(np.nanstd(y, axis=0), 1e-300)
    return tuple(OutputFit(n, float(b), float(a), None if floor is None else floor[j] / float(spread[j])) for j, (n, b, a) in enumerate(errors))


def nrmse(measured: Array, simulated: Array) -> Array:
    """Return ``|y - yhat| / |y - mean|`` per output over the samples that were measured, ``(p,)``; infinite where simulation left."""
    seen = np.isfinite(measured)
    e = np.where(seen, measured - simulated, 0.0)
    power = np.nansum((measured - np.nanmean(measured, axis=0)) ** 2, axis=0)
    left = ~np.isfinite(e).all(0)
    return np.where(left, np.inf, np.sqrt((np.where(left, 0.0, e) ** 2).sum(0) / np.maximum(power, 1e-300)))


def white(problem: Problem, held: Sequence[Course]) -> tuple[float, float]:
    """Return the p-values of Hosking's test on the weighted residuals before and after; 0 where a simulation left."""
    return _white(problem, [c.residual_before for c in held]), _white(problem, [c.residual_after for c in held])


def _white(problem: Problem, residuals: Sequence[Array]) -> float:
    if any(np.isinf(e).any() for e in residuals):
        return 0.0
    weighted = [problem.weighting(np.nan_to_num(e / problem.scale)) for e in residuals]
    return whiteness(np.vstack([w - w.mean(0) for w in weighted]))
