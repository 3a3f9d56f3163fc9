"""One round of the search: every hypothesis screened, the promising fitted, the best refined with the nuisance and scored."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.fit import Trial, apply_shift, fit, screen
from afdsvc.explain.objective import Borrowed, Point, Tangent, borrowed, tangent
from afdsvc.explain.settle import full_cost, settle, started
from afdsvc.explain.simulator import Effect
from afdsvc.explain.transfer import Transferred, transfers
from afdsvc.lti.statespace import Array
from afdsvc.stats.periodic import repeated

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
FITTED, REFINED, SETTLED, TRANSFERRED = 18, 8, 6, 3  # how many hypotheses survive each stage; constants looked at besides
BLOCKS = 60
PART, LEAST_PART, SCREENED = 5, 1000, 30  # a first screen on a fifth of every run keeps so many hypotheses
SLOW = ("offset",)  # families that need a whole run to show
HOPELESS = 8.0  # fall of the cost that no hypothesis reached in the screen below which none is fitted


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A refined hypothesis (None: nothing added): where the search would stand with it, and what it costs.

    ``train`` is the full cost on the training runs (prior included), ``select`` the cost on runs never fitted, ``blocks``
    the costs of consecutive pieces of both, ``parameters`` how many numbers were fitted for it. ``heard`` and ``kept`` are the
    whitened residuals of the training and the selection runs (of the empty candidate), ``differs`` the sum of squares by which
    another's differ from the latter.
    """

    hypothesis: Hypothesis | None
    point: Point
    train: float
    select: float
    blocks: Array
    parameters: int
    heard: tuple[Array, ...] = ()
    kept: tuple[Array, ...] = ()
    differs: float = np.inf

    @property
    def effect(self) -> Effect:
        """The effect this candidate adds."""
        return self.point.effects[self.place]

    @property
    def place(self) -> int:
        """Which of the point's effects this candidate adds: those at one port act one after the other."""
        keys = [e.hypothesis.key for e in self.point.effects]
        return len(keys) - 1 - keys[::-1].index(self.key)

    @property
    def key(self) -> str:
        """Name and site of the hypothesis; "nothing" when there is none."""
        return self.hypothesis.key if self.hypothesis else "nothing"


def evaluate(
    base: Baseline, select: Sequence[Run], hypothesis: Hypothesis | None, point: Point, beside: Candidate | None = None
) -> Candidate:
    """Return the candidate with its costs; the initial states of the selection runs are fitted, nothing else there.

    ``beside`` is the empty candidate. A predictor that assumes process noise answers noise too, and a law may mend how: what does
    not repeat with the excitation is then no evidence for a law that would show in what does.
    """
    chosen = replace(base.objective, runs=tuple(select))
    heard = base.objective.whitened(point)
    kept = chosen.whitened(started(chosen, point)) if select else []
    strain = float(np.dot(point.theta, point.theta))
    if beside is None or hypothesis is None:
        return Candidate(hypothesis, point, strain + _squares(heard), _squares(kept), block_costs([*heard, *kept]), 0, tuple(heard), tuple(kept))
    if base.limited == "noise" and base.ratio > 0 and not any(s.kind in ("aux", "t") for s in hypothesis.reads):
        heard = [repeated(*three) for three in zip(base.objective.runs, heard, beside.heard, strict=True)]
        kept = [repeated(*three) for three in zip(select, kept, beside.kept, strict=True)]
    differs = _squares([a - b for a, b in zip(kept, beside.kept, strict=True)])
    count = sum(c.free for c in hypothesis.parameters)
    return Candidate(hypothesis, point, strain + _squares(heard), _squares(kept), block_costs([*heard, *kept]), count, differs=differs)


def _squares(pieces: Sequence[Array]) -> float:
    return float(sum((w**2).sum() for w in pieces))


def block_costs(pieces: Sequence[Array]) -> Array:
    """Return sums of squares over about `BLOCKS` consecutive pieces of equal length."""
    length = max(1, sum(len(w) for w in pieces) // BLOCKS)
    costs = []
    for w in pieces:
        count = max(1, len(w) // length)
        squares = (w**2).sum(1)[: count * (len(w) // count)]
        costs += list(squares.reshape(count, -1).sum(1))
    return np.array(costs)


def round_of(
    base: Baseline, select: Sequence[Run], hypotheses: Sequence[Hypothesis], mapper: Mapper = map,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Candidate]:
    """Return the refined candidates of one round, by cost on the training runs, the empty one among them."""
    t = tangent(base.objective, base.point)
    progress("screening", 0.0)
    trials = sorted(mapper(partial(screen, t), _preselected(base, hypotheses, mapper)), key=lambda x: x.cost)
    nothing = evaluate(base, select, None, base.point)
    changed = _one_way_each(transfers(t, hypotheses, HOPELESS))[:TRANSFERRED] if base.limited == "noise" else []
    if not trials or (t.cost - trials[0].cost < HOPELESS and not changed):
        return [nothing, *(evaluate(base, select, x.hypothesis, apply_shift(t, Effect(x.hypothesis, x.values)), nothing) for x in trials[:1])]
    progress("fitting", 0.3)
    fitted = sorted(mapper(partial(_fitted, t), trials[:FITTED]), key=lambda x: x.cost)
    progress("refining", 0.6)
    close = _each_once([
        *mapper(partial(_shifted, base, t), _diverse(fitted, REFINED)), *((full_cost(base.objective, p), h, p) for _, h, p in changed),
    ])
    near, far = _promising(close, {h.key for _, h, _ in changed})
    settled = [*mapper(partial(_settled, base, _lent(base, t)), near), *((h, p) for _, h, p in far)]
    refined = list(mapper(partial(_evaluated, base, select, nothing), settled))
    progress("refining", 1.0)
    return sorted([nothing, *refined], key=lambda c: c.train)


def _preselected(base: Baseline, hypotheses: Sequence[Hypothesis], mapper: Mapper) -> Sequence[Hypothesis]:
    """Return the hypotheses that do best on the first part of every run, where that part is long enough to tell.

    Those that act slowly or follow another signal stay in: a part of a run says little about them.
    """
    runs = tuple(r.span(0, len(r) // PART) for r in base.objective.runs)
    if len(hypotheses) <= SCREENED or base.limited != "noise" or min(len(r) for r in runs) < LEAST_PART:
        return hypotheses
    t = tangent(replace(base.objective, runs=runs), base.point)
    slow = [h for h in hypotheses if h.family in SLOW or any(s.kind in ("aux", "t") for s in h.reads)]
    quick = [h for h in hypotheses if h not in slow]
    costs = [x.cost for x in mapper(partial(screen, t), quick)]
    return [*slow, *(quick[i] for i in np.argsort(costs, kind="stable")[:SCREENED])]


def _fitted(t: Tangent, trial: Trial) -> Trial:
    """Return the fit from the start with the best prospects, or from the one that costs least, whichever ends lower."""
    first = fit(t, trial.hypothesis, trial.values)
    if trial.other is None or np.array_equal(trial.other, trial.values):
        return first
    return min(first, fit(t, trial.hypothesis, trial.other), key=lambda x: x.cost)


def _diverse(trials: Sequence[Trial], count: int) -> list[Trial]:
    """Return the best trials and, besides, the best of every other family among them."""
    best = list(trials[:count])
    families = {t.hypothesis.family for t in best}
    for t in trials[count:]:
        if t.hypothesis.family not in families:
            families.add(t.hypothesis.family)
            best.append(t)
    return best


def _shifted(base: Baseline, t: Tangent, trial: Trial) -> tuple[float, Hypothesis, Point]:
    """Return the cost and the point with the hypothesis, the nuisance shifted with it or left, whichever is better."""
    effect = Effect(trial.hypothesis, trial.values)
    both = [(full_cost(base.objective, p), p) for p in (apply_shift(t, effect), t.point.with_effect(effect))]
    cost, point = min(both, key=lambda pair: pair[0])
    if cost > trial.cost + max(1.0, 3e-3 * trial.cost):
        point = settle(base.objective, point, 2, known=_lent(base, t))
        cost = full_cost(base.objective, point)
    return cost, trial.hypothesis, point


def _one_way_each(found: Iterable[Transferred]) -> list[Transferred]:
    """Return every constant in the best of the ways in which it may have changed (alone, or with its couplings), in the order given."""
    best: dict[tuple[str, str], Transferred] = {}
    for x in found:
        best.setdefault((x[1].site, x[1].parameters[0].name), x)
    return list(best.values())


def _each_once(found: Iterable[Transferred]) -> list[Transferred]:
    """Return costs, hypotheses and points from the best on, every hypothesis at its best point alone."""
    best: dict[str, Transferred] = {}
    for x in sorted(found, key=lambda x: x[0]):
        best.setdefault(x[1].key, x)
    return list(best.values())


def _promising(found: Sequence[Transferred], constants: set[str]) -> tuple[list[Transferred], list[Transferred]]:
    """Split what was found, best first, into what is settled and what is not; ``constants`` always are.

    What other numbers took over is handed back to a constant by a linear step, which may be a long one: its cost there is no verdict.
    """
    near = [k for k, x in enumerate(found) if k < SETTLED or x[1].key in constants]
    return [found[k] for k in near], [x for k, x in enumerate(found) if k not in near]


def _lent(base: Baseline, t: Tangent) -> Borrowed | None:
    """Return the columns refits may begin with: none where the model limits, for its residual weighs their errors."""
    return borrowed(t) if base.limited == "noise" else None


def _settled(base: Baseline, known: Borrowed | None, found: Transferred) -> tuple[Hypothesis, Point]:
    return found[1], settle(base.objective, found[2], 20, known=known)


def _evaluated(base: Baseline, select: Sequence[Run], nothing: Candidate, found: tuple[Hypothesis, Point]) -> Candidate:
    return evaluate(base, select, *found, nothing)
