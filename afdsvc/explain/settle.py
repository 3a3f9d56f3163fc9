"""Refitting the nuisance at a point: Gauss-Newton on the true cost, with step halving."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.explain.fit import moved
from afdsvc.explain.objective import Borrowed, Objective, Point, Slope, prior_rows, slope
from afdsvc.lti.statespace import Array

REUSED = 3  # steps taken with one tangent
LENT = 4  # slopes with borrowed columns before own ones are worked out
SETTLED = 0.2  # fall of the cost at which a refit with borrowed columns counts as settled


def raw(objective: Objective, point: Point) -> list[Array]:
    """Return the residuals before whitening, one ``(n, p)`` per run."""
    return [objective.residual(i, point.theta, x0, point.effects) for i, x0 in enumerate(point.x0)]


def started(objective: Objective, point: Point) -> Point:
    """Return the point with the initial states that fit the runs best, whichever it had.

    They are looked for from rest and, in runs in which that comes out behind the states that fit without the effects, from
    those: a law that is not smooth may not show the way from rest.
    """
    rest = replace(point, x0=tuple(np.zeros(objective.simulator.nominal.plant.order) for _ in objective.runs))
    there = settle(objective, rest, 2, states_only=True)
    if not point.effects:
        return there
    plain = settle(objective, replace(rest, effects=()), 2, states_only=True)
    better = _better_each(objective, there, replace(point, x0=plain.x0))
    return there if better is there else settle(objective, better, 2, states_only=True)


def _better_each(objective: Objective, one: Point, other: Point) -> Point:
    """Return one point with the initial states of the other in the runs that these fit better; itself where there are none."""
    costs = [[float((w**2).sum()) for w in objective.whitened(p)] for p in (one, other)]
    behind = [there < here for here, there in zip(*costs, strict=True)]
    x0 = tuple(b if worse else a for a, b, worse in zip(one.x0, other.x0, behind, strict=True))
    return replace(one, x0=x0) if any(behind) else one


def settle(
    objective: Objective, point: Point, iterations: int = 6, states_only: bool = False, known: Borrowed | None = None
) -> Point:
    """Return the point refitted in its nuisance (initial states, theta within its prior, parameters of its effects).

    It begins with ``known`` columns where there are some, and works out its own as soon as those do not lead on.
    """
    damping = 0.0
    for turn in range(iterations):
        if turn == LENT:
            known = None
        t = slope(objective, point, states_only, known)
        before = float(t.full @ t.full)
        point, after, damping = _descend(objective, t, before, damping, states_only)
        if _done(before, after):
            if known is None or (damping == 0 and 0 < before - after < SETTLED):
                break
            known, damping = None, 0.0
            continue
        point, done = _again(objective, t, point, after, states_only)
        if done and known is None:
            break
    return point


def _done(before: float, after: float) -> bool:
    return before - after < 3e-4 * before and before - after < 1.0


def _again(objective: Objective, t: Slope, point: Point, cost: float, states_only: bool) -> tuple[Point, bool]:
    """Return the point after further steps with the same tangent, each a single simulation, and whether they converged."""
    k = 0 if states_only else len(point.theta)
    for _ in range(REUSED):
        full = np.concatenate([objective.vector(point), prior_rows(point, k, t.r.shape[0])])
        step = t.shift(full)
        new = _moved_states(point, step) if states_only else moved(point, step)
        after = full_cost(objective, new, states_only)
        if not after < cost:
            return point, cost - after > -1e-3
        point, before, cost = new, cost, after
        if _done(before, after):
            return point, True
    return point, False


def _descend(
    objective: Objective, t: Slope, before: float, damping: float, states_only: bool
) -> tuple[Point, float, float]:
    """Return the first point along ever more damped steps that costs less, its cost, and the damping to go on with."""
    for tried in (damping, *(10.0**k for k in (-3, -2, -1, 0, 1, 2))):
        if tried < damping:
            continue
        step = t.shift(t.full, tried)
        new = _moved_states(t.point, step) if states_only else moved(t.point, step)
        cost = full_cost(objective, new, states_only)
        if cost < before:
            return new, cost, tried / 10 if tried > 1e-3 else 0.0
    return t.point, before, damping


def _moved_states(point: Point, step: Array) -> Point:
    at, x0 = 0, []
    for x in point.x0:
        x0.append(x + step[at : at + len(x)])
        at += len(x)
    return replace(point, x0=tuple(x0))


def full_cost(objective: Objective, point: Point, states_only: bool = False) -> float:
    """Return the sum of squares with the prior of theta."""
    data = objective.vector(point)
    return float(data @ data) + (0.0 if states_only else float(np.dot(point.theta, point.theta)))
