"""Fitting one hypothesis: a cheap screen, then Gauss-Newton in its parameters with the nuisance projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.physics import Coefficient, Hypothesis
from afdsvc.explain.objective import Point, Tangent, small_step
from afdsvc.explain.simulator import Effect
from afdsvc.lti.statespace import Array

ITERATIONS = 12
LITTLE = 1e-4  # relative fall of the cost at which a fit stops


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A hypothesis with values, and the cost it reaches in the tangent (sum of squares, prior included).

    Of a start: ``cost`` with an amplitude as good as can be, ``plain`` with the values as they are, ``other`` the values of
    another start worth fitting.
    """

    hypothesis: Hypothesis
    values: Array
    cost: float
    plain: float = np.inf
    other: Array | None = None


def residual_with(tangent: Tangent, effect: Effect) -> Array:
    """Return the projected residual when this effect is added at the tangent's point."""
    data = tangent.objective.vector(tangent.point.with_effect(effect))
    return tangent.rest + tangent.project(data - tangent.full[: data.size])


def screen(tangent: Tangent, hypothesis: Hypothesis) -> Trial:
    """Return the most promising start of a hypothesis, with the cost a free amplitude would reach from it.

    Another start is kept beside it: for a law without an amplitude the one that costs least as it stands, else the first.
    """
    tried = [_from_start(tangent, hypothesis, np.array(s, float)) for s in hypothesis.starts]
    best = min(tried, key=lambda t: t.cost)
    return replace(best, other=min(tried, key=lambda t: t.plain).values)


def _from_start(tangent: Tangent, hypothesis: Hypothesis, start: Array) -> Trial:
    free = [j for j, c in enumerate(hypothesis.parameters) if c.linear]
    if not free:
        change = residual_with(tangent, Effect(hypothesis, start)) - tangent.rest
        power, along = float(change @ change), float(change @ tangent.rest)
        factor = -along / power if power > 0 else 0.0
        cost = tangent.cost - (factor**2 * power if factor > 0 else 0.0)
        return Trial(hypothesis, start, cost, tangent.cost + 2 * along + power)
    columns = []
    for j in free:
        values = start.copy()
        values[free] = 0.0
        values[j] = hypothesis.parameters[j].scale
        columns.append(residual_with(tangent, Effect(hypothesis, values)) - tangent.rest)
    S = np.column_stack(columns)
    factors, *_ = np.linalg.lstsq(S, -tangent.rest, rcond=1e-8)
    values = start.copy()
    values[free] = [f * hypothesis.parameters[j].scale for f, j in zip(factors, free, strict=True)]
    values = inside(hypothesis.parameters, values)
    ratio = values[free] / [hypothesis.parameters[j].scale for j in free]
    rest = tangent.rest + S @ ratio
    return Trial(hypothesis, values, float(rest @ rest))


def inside(parameters: Sequence[Coefficient], values: Array) -> Array:
    """Return the values held to their ranges."""
    return np.clip(values, [c.low for c in parameters], [c.high for c in parameters])


def fit(tangent: Tangent, hypothesis: Hypothesis, start: Array, iterations: int = ITERATIONS) -> Trial:
    """Return the local optimum from a start: damped Gauss-Newton in the (logarithmic where positive) parameters."""
    values = inside(hypothesis.parameters, start)
    if not any(c.free for c in hypothesis.parameters):
        iterations = 0
    rest = residual_with(tangent, Effect(hypothesis, values))
    cost, damping = float(rest @ rest), 1e-3
    for _ in range(iterations):
        J, units = _jacobian(tangent, hypothesis, values, rest)
        better = None
        for _ in range(6):
            moved = _step(hypothesis, values, J, units, rest, damping)
            trial = residual_with(tangent, Effect(hypothesis, moved))
            if float(trial @ trial) < cost:
                better = moved, trial
                break
            damping *= 6
        if better is None:
            break
        fall = cost - float(better[1] @ better[1])
        values, rest, cost, damping = better[0], better[1], cost - fall, damping / 10
        if fall < LITTLE * cost and fall < 0.5:
            break
    return Trial(hypothesis, values, cost)


def _logarithmic(c: Coefficient, value: float) -> bool:
    return c.low >= 0 and value > 0 and not c.linear


def _jacobian(tangent: Tangent, hypothesis: Hypothesis, values: Array, rest: Array) -> tuple[Array, Array]:
    """Return d(rest)/d(parameter in its own unit) and that unit: the value itself for logarithmic ones, else the scale."""
    columns, units = [], []
    for j, c in enumerate(hypothesis.parameters):
        if not c.free:
            continue
        step = small_step(values[j], c.scale, c.low, c.high)
        moved = values.copy()
        moved[j] += step
        unit = values[j] if _logarithmic(c, values[j]) else max(abs(values[j]), c.scale)
        columns.append((residual_with(tangent, Effect(hypothesis, moved)) - rest) * (unit / step))
        units.append(unit)
    return np.column_stack(columns), np.array(units)


def _step(hypothesis: Hypothesis, values: Array, J: Array, units: Array, rest: Array, damping: float) -> Array:
    """Return the values after a damped step, held to their ranges."""
    H, g = J.T @ J, J.T @ rest
    scale = np.diag(np.diag(H) + 1e-12 * max(float(np.trace(H)), 1e-300))
    free = [j for j, c in enumerate(hypothesis.parameters) if c.free]
    at_low, at_high = (np.array([values[j] == getattr(hypothesis.parameters[j], end) for j in free]) for end in ("low", "high"))
    move = _within(H + damping * scale, g, at_low, at_high)
    new = values.copy()
    for j, by, unit in zip(free, move, units, strict=True):
        if _logarithmic(hypothesis.parameters[j], values[j]):
            new[j] = values[j] * np.exp(np.clip(by, -1.5, 1.5))
        else:
            new[j] = values[j] + by * unit
    return inside(hypothesis.parameters, new)


def _within(H: Array, g: Array, at_low: NDArray[np.bool_], at_high: NDArray[np.bool_]) -> Array:
    """Return the step ``-H^-1 g``; what stands at an end of its range and would leave it stays, the others step without it."""
    move, moving = np.zeros(len(g)), np.ones(len(g), bool)
    while moving.any():
        move[:] = 0.0
        move[moving] = -np.linalg.lstsq(H[np.ix_(moving, moving)], g[moving], rcond=None)[0]
        leaving = moving & (((move < 0) & at_low) | ((move > 0) & at_high))
        if not leaving.any():
            return move
        moving &= ~leaving
    return np.zeros(len(g))


def apply_shift(tangent: Tangent, effect: Effect | None) -> Point:
    """Return the tangent's point moved by the nuisance step that goes with an added effect, the effect included."""
    point = tangent.point if effect is None else tangent.point.with_effect(effect)
    data = tangent.objective.vector(point)
    step = tangent.shift(tangent.with_data(data))
    return moved(tangent.point, step, effect)


def moved(point: Point, step: Array, effect: Effect | None = None) -> Point:
    """Return a point moved by a nuisance step, effect parameters held to their ranges."""
    k = len(point.theta)
    at, x0 = k, []
    for x in point.x0:
        x0.append(x + step[at : at + len(x)])
        at += len(x)
    effects = []
    for e in point.effects:
        values = inside(e.hypothesis.parameters, e.values + step[at : at + len(e.values)])
        effects.append(replace(e, values=values))
        at += len(e.values)
    return Point(point.theta + step[:k], tuple(x0), (*effects, *([effect] if effect else [])))
