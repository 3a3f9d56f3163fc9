"""What the recordings held out allow to be said: names that do not follow them better are doubted or withdrawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import ttest_1samp

from afdsvc.api.physics import LONG_AGO
from afdsvc.dataset.experiment import Run
from afdsvc.explain.noise.weighting import power_time
from afdsvc.explain.search.build import initial
from afdsvc.explain.search.evidence import block_spans
from afdsvc.explain.search.fit import Coordinates, Fit, fit, rms
from afdsvc.explain.search.forward import Found
from afdsvc.explain.search.problem import NUISANCE, Point, Problem, loop_known
from afdsvc.explain.search.ranking import is_constant, is_offset
from afdsvc.explain.verdict.verdict import DOUBT, Verdict
from afdsvc.lti.statespace import Array

WORSE = 1.1  # ratio of held-out errors, after to before, beyond which names are withdrawn
WAYS = ("from the inputs", "in closed loop", "predicted")


@dataclass(frozen=True, slots=True, eq=False)
class Player:
    """Plays a model over recordings: ``way`` is one of `WAYS`; only initial states are fitted."""

    problem: Problem
    way: str
    horizon: float

    def outputs(self, runs: Sequence[Run], point: Point) -> list[Array]:
        """Return the simulated outputs ``(n, p)`` of every run, from the initial state that fits it best."""
        return self.begun(runs, point)[2]

    def begun(self, runs: Sequence[Run], point: Point) -> tuple[Problem, Point, list[Array]]:
        """Return the problem on other runs, the point with the initial states that fit them best, and the simulated outputs."""
        there = on(self.problem, runs)
        outputs, states = played_back(there, point.rested(there.x0), self.horizon)
        return there, point.rested(states), outputs

    def nrmse(self, runs: Sequence[Run], point: Point) -> Array:
        """Return ``|y - yhat| / |y - mean|`` of every output over all runs, ``(p,)``; infinite where a simulation left."""
        return nrmse(np.vstack([r.Y for r in runs]), np.vstack(self.outputs(runs, point)))

    def better(self, runs: Sequence[Run], before: Point, after: Point) -> float:
        """Return how sure it is that ``after`` follows the recordings better than ``before``: 1 less twice the smaller p-value of two tests.

        One is a t-test of the logarithm of the ratio of their losses over blocks whose powers are independent: it sees small differences
        in long recordings. The other is the F-test of the ratio over all recordings, each loss with as many degrees of freedom as its
        residual has samples of independent power: it sees large ones in short recordings. Residuals are weighted as in the search, and outputs
        count by what ``before`` misses. A moment that was sought there counts as many tests (Bonferroni). 0 where a simulation left, or all recordings
        together are followed worse.
        """
        weighting, scale = self.problem.weighting, self.problem.scale
        outputs = [self.outputs(runs, p) for p in (before, after)]
        if not all(np.isfinite(y).all() for y in outputs[1]):
            return 0.0
        errors = [[(r.Y - y) / scale for r, y in zip(runs, pieces, strict=True)] for pieces in outputs]
        first, second = ([weighting(np.nan_to_num(e)) for e in pieces] for pieces in errors)
        first, second = ([e / rms(first) for e in pieces] for pieces in (first, second))
        spans = block_spans([len(r) for r in runs], power_time(first), self.problem.settings)
        losses = np.array([[float((e[r][a:b] ** 2).sum()) for e in (first, second)] for r, a, b in spans]) + 1e-300
        ratio, total = np.log(losses[:, 0] / losses[:, 1]), losses[:, 0].sum() / losses[:, 1].sum()
        if not total > 1:
            return 0.0
        steady = float(ttest_1samp(ratio, 0.0, alternative="greater").pvalue) if np.ptp(ratio) > 0 else 1.0
        degrees = [sum(e.size for e in pieces) / power_time(pieces) for pieces in (first, second)]
        tried = float(MOMENTS ** max(0, len(moments(after)) - len(moments(before))))
        return 1 - 2 * min(tried * steady, tried * float(f_distribution.sf(total, *degrees)), 0.5)


def player(problem: Problem, last: float) -> Player:
    """Return the way to play what was judged at a horizon: from the inputs where the search could, else in closed loop where that is
    known, else predicted."""
    if last == 0.0:
        return Player(problem, WAYS[problem.closed], 0.0)
    if loop_known(problem):
        return Player(replace(problem, closed=True), WAYS[1], 0.0)
    return Player(problem, WAYS[2], last)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutVerdict:
    """A verdict and its final fit after a look at the recordings held out; ``unconfirmed`` where there is a gap, but they do not confirm its first
    name: it is withdrawn, or they are likely followed better without it."""

    verdict: Verdict
    final: Fit
    unconfirmed: bool = False


def checked_on_holdout(found: Found, verdict: Verdict, runs: Sequence[Run], attempt: int = 1) -> HeldOutVerdict:
    """Return the verdict and the final fit: with the claimed effects, else the numbers refitted, else the model as stated.

    What does worse on the recordings held out than the model as stated is withdrawn. What does not do better there than the model
    as stated and refitted without effects, or worse than a constant, is not certain; where that is all that can show a gap, the error has to fall there,
    no name is surer than that, and what is not likely is not claimed, the less so the more names were tried (``attempt`` from 1; Bonferroni).
    Where the gap test finds no gap and they are likely followed better without a name, it is not claimed either.
    """
    last, most, unconfirmed = list(found.end)[-1], found.problem.settings.uncertain, False
    play = player(found.problem, last)
    about_zero = bool(verdict.claims) and is_offset(verdict.claims[0].candidate.hypothesis)  # every other refit has an offset, too
    refit = _refitted_about_zero(found) if about_zero else found.start[last].point
    stated, refitted = (_error(play, runs, p) for p in (found.problem.start(), refit))
    if verdict.claims:
        first = verdict.claims[0].candidate.hypothesis
        final = _with(found, {c.candidate.hypothesis.key for c in verdict.claims})
        error = _error(play, runs, final.point)
        without = _without(found, verdict, refit if refitted < stated else found.problem.start())
        sure = play.better(runs, without, final.point) if error < 1.0 else 0.0
        shown, w = sure > found.problem.settings.sure, found.problem.weighting
        alone = not (w.measured or (w.even and verdict.gap.present) or is_constant(first))  # neither known noise nor the gap test shows a gap
        held = (
            f"on the recordings held out the error is {100 * error:.3g} % with {first.title}, {100 * stated:.3g} % with the model as stated "
            f"and {100 * refitted:.3g} % with its numbers refitted"
        )
        worse = error > (1.0 if alone else WORSE) * min(stated, refitted)
        likely = sure > 1 - (1 - found.problem.settings.probable) / attempt
        beaten = not likely and play.better(runs, final.point, without) > found.problem.settings.probable
        if not worse and (likely or not alone) and not (beaten and not verdict.gap.present):
            most = min(most, sure if alone else max(sure, found.problem.settings.probable))
            return HeldOutVerdict(verdict if shown and not alone else doubted(verdict, f"{held}{'; only the recordings held out show that there is a gap' if alone else ''}: no name is certain", most), final, beaten)
        verdict, unconfirmed = unclaimed(verdict, f"{held}: nothing is claimed", alone), not alone or verdict.gap.total > DOUBT
    if refitted <= WORSE * stated:
        return HeldOutVerdict(verdict, found.start[last], unconfirmed)
    return HeldOutVerdict(verdict, fit(found.problem, found.problem.start(), last, found.start[last].tau, iterations=0), unconfirmed)


def _with(found: Found, keys: set[str]) -> Fit:
    """Return the final fit with these effects only (and the unknown loads every fit has), refitted where others go."""
    last = list(found.end)[-1]
    end = found.end[last]
    kept = tuple(e for e in end.point.effects if e.hypothesis.key in keys or e.hypothesis.family == NUISANCE)
    return end if len(kept) == len(end.point.effects) else fit(found.problem, replace(end.point, effects=kept), last, end.tau)


def _without(found: Found, verdict: Verdict, model: Point) -> Point:
    """Return what the names are compared with: the model with its offsets only, or as stated, or the better ``model`` of those stated and refitted:
    what is only better than a refit that went astray is not better."""
    first, *others = [c.candidate.hypothesis for c in verdict.claims]
    offsets = {h.key for h in others if is_offset(h) and not (is_offset(first) or is_constant(first))}
    if offsets:
        return _with(found, offsets).point
    return found.problem.start() if is_constant(first) else model


def _refitted_about_zero(found: Found) -> Point:
    """Return the model refitted without effects and without offsets."""
    last, base = list(found.start.items())[-1]
    return fit(replace(found.problem, offset_free=False), replace(base.point, offset=0 * base.point.offset), last, base.tau).point


def _error(play: Player, runs: Sequence[Run], point: Point) -> float:
    return float(np.mean(play.nrmse(runs, point)))


def unclaimed(verdict: Verdict, why: str, doubtful: bool) -> Verdict:
    """Return the verdict without its names, and what the gap test says; ``why`` in a sentence. Where it is ``doubtful`` that there is a gap, its size decides."""
    seen = not doubtful or verdict.gap.present or verdict.gap.total > DOUBT
    return replace(verdict, verdict="unexplained" if seen else "consistent", claims=(), sentences=(verdict.gap.sentence, why))


def doubted(verdict: Verdict, why: str, most: float) -> Verdict:
    """Return the verdict with no name of more than this weight; ``why`` in a sentence."""
    claims = tuple(replace(c, weight=min(c.weight, most)) for c in verdict.claims)
    return replace(verdict, claims=claims, sentences=(*verdict.sentences, why))


def nrmse(measured: Array, simulated: Array) -> Array:
    """Return ``|y - yhat| / |y - mean|`` per output over the samples that were measured, ``(p,)``; infinite where simulation left."""
    seen = np.isfinite(measured)
    e = np.where(seen, measured - simulated, 0.0)
    power = np.nansum((measured - np.nanmean(measured, axis=0)) ** 2, axis=0)
    left = ~np.isfinite(e).all(0)
    return np.where(left, np.inf, np.sqrt((np.where(left, 0.0, e) ** 2).sum(0) / np.maximum(power, 1e-300)))


PASSES = 4
MOMENTS, CLOSER = 24, 3  # of a recording, at which a change is tried, and how often the time around the best is searched more closely


def on(problem: Problem, runs: Sequence[Run]) -> Problem:
    """Return the same problem on other runs, their initial states guessed from their first samples."""
    there = problem.of(runs, [np.zeros(problem.nominal.plant.order) for _ in runs])
    return replace(there, x0=tuple(initial(there, k) for k in range(len(runs))))


def played_back(problem: Problem, point: Point, horizon: float = 0.0) -> tuple[list[Array], list[Array]]:
    """Return the simulated outputs of every run ``(n, p)`` and the initial states that fit them best."""
    runs, states = [], []
    for k, x0 in enumerate(problem.x0):
        one = problem.of([problem.runs[k]], [x0])
        there = _begun(one, point.rested([x0]), horizon)
        runs.append(one.simulated(there, horizon)[0].y)
        states.append(there.x0[0])
    return runs, states


def _begun(problem: Problem, point: Point, horizon: float) -> Point:
    """Return the point with the initial state of the only run, and what memories begin with, that fit it best: from the state of the point and from rest.

    A state that makes up for what the model lacks is a local minimum beside a law that is right.
    """
    point = _timed(problem, point, horizon)
    found = [_begun_near(problem, p, horizon) for p in (point, replace(point, x0=problem.resting()))]
    return min(found, key=lambda pair: pair[1])[0]


def _timed(problem: Problem, point: Point, horizon: float) -> Point:
    """Return the point with every change that comes at a moment at the one at which the only run shows it, or before or after the run: no other recording says when."""
    run, width = problem.runs[0], len(problem.runs[0]) * problem.runs[0].dt / 2

    def missed(there: Point) -> float:
        return float(np.linalg.norm(problem.residuals(there, horizon)[0]))

    for i, j in moments(point):
        best, span = _valued(point, i, j, run.begins + width), width
        for _ in range(CLOSER):
            best = min((_valued(best, i, j, best.effects[i].values[j] + span * s) for s in np.linspace(-1, 1, MOMENTS + 1)), key=missed)
            span *= 2 / MOMENTS
        point = min((_valued(best, i, j, LONG_AGO), best), key=missed)
    return point


def moments(point: Point) -> list[tuple[int, int]]:
    """Return the numbers of effects that come at a moment, and of the parameters that say when."""
    return [(i, j) for i, e in enumerate(point.effects) for j, c in enumerate(e.hypothesis.parameters) if c.later == LONG_AGO]


def _valued(point: Point, i: int, j: int, value: float) -> Point:
    """Return the point with another value of parameter ``j`` of effect ``i``."""
    values = point.effects[i].values.copy()
    values[j] = value
    return replace(point, effects=(*point.effects[:i], replace(point.effects[i], values=values), *point.effects[i + 1 :]))


def _begun_near(problem: Problem, point: Point, horizon: float) -> tuple[Point, float]:
    """Return the point at the nearest initial state that fits best, by damped Gauss-Newton, and the sum of squares that remains."""
    c = Coordinates(problem, point)
    q, local = c.pack(point), slice(c.shared, c.size)

    def moved(x: Array) -> Point:
        there = c.unpack(np.concatenate([q[: c.shared], x]))
        return replace(there, effects=tuple(replace(e, begun=f.begun) for e, f in zip(point.effects, there.effects, strict=True)))

    def residual(x: Array) -> Array:
        return problem.residuals(moved(x), horizon)[0].ravel()

    x = q[local]
    e, damping = residual(x), 1e-6
    for _ in range(PASSES if len(x) else 0):
        J = np.column_stack([(residual(x + 1e-3 * row) - e) / 1e-3 for row in np.eye(len(x))])
        H = J.T @ J + 1e-6 * len(e) * np.eye(len(x))
        for _ in range(4):
            step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), J.T @ e)
            there = residual(x + step)
            if there @ there < e @ e:
                x, e, damping = x + step, there, damping / 10
                break
            damping = max(10 * damping, 1e-3)
        else:
            break
    return moved(x), float(e @ e)
