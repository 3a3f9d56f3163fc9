"""Demands on what was named: that nothing repeating is left, and that its law has the right shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.explain.baseline import Baseline
from afdsvc.explain.forward import BAND, Yardstick
from afdsvc.explain.objective import Objective, Point, tangent
from afdsvc.explain.simulator import Effect
from afdsvc.explain.sizes import bandwidth
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import unpredictable, whiteness_p
from afdsvc.stats.periodic import Repeating, repeating


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """How much of the gap is explained: the fraction with its sd, what repeated before and after (None: nothing repeats).

    ``p_left`` is the p-value of the test that nothing is left: of what repeats, else of the whiteness of the residual.
    """

    fraction: float
    sd: float
    before: Repeating | None
    after: Repeating | None
    p_left: float = 0.0


def explained(yardstick: Yardstick, null: Point, final: Point) -> Explained:
    """Return the explained fraction, from what repeats with the excitation where that can be told, else from the cost.

    Where the noise is not known apart from the model, what the final residual's own past does not predict counts as noise.
    """
    w0, w1 = yardstick.whitened(null), yardstick.whitened(final)
    runs = (*yardstick.base.objective.runs, *yardstick.select)
    top = BAND * bandwidth(runs)
    before, after = repeating(runs, w0, top), repeating(runs, w1, top)
    c0, c1 = (float(sum((w**2).sum() for w in ws)) for ws in (w0, w1))
    numbers = sum(w.size for w in w0)
    noisy = yardstick.base.limited == "noise"
    spread = np.sqrt(2.0 * numbers) if noisy else 0.0
    floor = float(numbers) if noisy else c1 * unpredictable(w1)
    gap = max(c0 - floor, spread, 1e-9 * c0)
    by_cost = (c0 - c1) / gap
    if before is None or after is None or before.total.power < 5 * before.total.sd:
        p_left = after.total.p if after is not None else whiteness_p(w1)
        return Explained(float(by_cost), float(spread / gap), before, after, p_left)
    ratio = after.total.power / before.total.power
    sd = float(np.hypot(after.total.sd, ratio * before.total.sd) / before.total.power)
    return Explained(float(1 - ratio), sd, before, after, after.total.p)


@dataclass(frozen=True, slots=True)
class Shape:
    """A test of a law's shape: the cost two free terms take away, as a likelihood ratio and as a share of the effect's own."""

    gain: float
    share: float
    bend: tuple[float, float, float]


def shape(base: Baseline, number: int) -> Shape | None:
    """Return the shape test of effect ``number`` at the end of the search; None where a law has nothing to be bent along."""
    effect = base.point.effects[number]
    if effect.hypothesis.reads[:1] == () or effect.hypothesis.reads[0].kind in ("t", "aux"):
        return None
    reference = _reference(base, effect)
    without = replace(base.point, effects=base.point.effects[:number] + base.point.effects[number + 1 :])
    own = _cost(base.objective, without) - _cost(base.objective, base.point)
    gain, coefficients = _bend(base, number, reference)
    return Shape(gain, gain / max(own, 1e-300), (*coefficients, reference))


def _cost(objective: Objective, point: Point) -> float:
    v = objective.vector(point)
    return float(v @ v)


def _reference(base: Baseline, effect: Effect) -> float:
    """Return the rms of the law's first signal along the predicted trajectories."""
    signal = effect.hypothesis.reads[0]
    rows = []
    for run, x0 in zip(base.objective.runs, base.point.x0, strict=True):
        s = base.objective.simulator.run(run, base.point.theta, x0, base.point.effects)
        rows.append({"u": run.U, "x": s.x, "y": s.y}[signal.kind][:, signal.index])
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2))) or 1.0


def _bend(base: Baseline, number: int, reference: float, passes: int = 2) -> tuple[float, tuple[float, float]]:
    """Fit the two bending terms by Gauss-Newton with everything else projected out; return the gain and the terms."""
    t = tangent(base.objective, base.point)
    c: Array = np.zeros(2)
    step = 0.02

    def rest(values: Array) -> Array:
        effects: Sequence[Effect] = [
            replace(e, bend=(float(values[0]), float(values[1]), reference)) if k == number else e
            for k, e in enumerate(base.point.effects)
        ]
        data = base.objective.vector(replace(base.point, effects=tuple(effects)))
        return t.rest + t.project(data - t.full[: data.size])

    best = t.cost
    for _ in range(passes):
        here = rest(c)
        J = np.column_stack([(rest(c + step * np.eye(2)[k]) - here) / step for k in range(2)])
        move = -np.linalg.lstsq(J, here, rcond=1e-6)[0]
        tried = c + np.clip(move, -2, 2)
        cost = float(rest(tried) @ rest(tried))
        if not cost < best:
            break
        best, c = cost, tried
    return t.cost - best, (float(c[0]), float(c[1]))
