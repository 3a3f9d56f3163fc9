"""Forward selection: effects are added one at a time while the data ask for them, and dropped again when they do not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from afdsvc.api.physics import Machine, Physics
from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline, again, baseline
from afdsvc.explain.clock import aligned, reads_time
from afdsvc.explain.judge import Ruling, Tried, bent, judge, separation
from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Objective, Point
from afdsvc.explain.reconsider import reconsidered
from afdsvc.explain.search import Candidate, Mapper, block_costs, round_of
from afdsvc.explain.settle import raw, settle, started
from afdsvc.explain.sizes import bandwidth, machine
from afdsvc.explain.surest import surest
from afdsvc.lti.statespace import Array
from afdsvc.stats.periodic import repeating
from afdsvc.stats.spectral_peaks import peaks
from afdsvc.stats.tones import Tone, tones

WORTH_SAYING = 0.03  # share of the gap below which a further effect is not named
BETTER_SHAPE = 0.35  # share below which a second effect at the same place is only a better shape of the first
BETTER_ELSEWHERE = 0.1  # the same at another place, whose answer runs as that of the first
ALIKE = 0.4  # correlation of two answers from which one may be the other's better shape
SURE_SECOND = 4.0  # standard errors a further effect must show
SURE_UNSEEN = 50.0  # gain on recordings that were not fitted, twice the log-likelihood, from which it may show in a few places only
QUIET = 1e-3  # p-value above which what is left counts as noise
BAND = 1.5  # how far above the excitation what repeats is looked for
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """An accepted effect: the ruling that chose it and the share of the whole gap it closes."""

    ruling: Ruling
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The outcome of the search: the start, where it ended, the accepted steps, and the ruling that stopped it (or None).

    ``order`` gives, for every effect of the final point, the number of its step. ``select`` are the selection runs, their clocks
    set (like those of the training runs) by ``tone`` if there is one.
    """

    start: Baseline
    end: Baseline
    steps: tuple[Step, ...]
    last: Ruling | None
    order: tuple[int, ...]
    machine: Machine
    select: tuple[Run, ...]
    tone: Tone | None


def forward(
    nominal: Nominal, train: Sequence[Run], select: Sequence[Run], physics: Iterable[Physics], most: int = 3,
    mapper: Mapper = map, progress: Progress = lambda what, share: None,
) -> Found:
    """Add effects until none is worth saying; ``most`` at most."""
    base = start = baseline(nominal, train)
    yardstick = Yardstick(start, tuple(select))
    first = seen(start)
    costs, steps, order = [yardstick.cost(start.point)], [], []
    last: Ruling | None = None
    tone: Tone | None = None
    samples = (sum(r.Y.size for r in train), sum(r.Y.size for r in select))
    for number in range(most):
        sight = first if number == 0 else seen(base)
        if number and quiet(base, sight):
            break
        if sight.tones and not reads_time(base.point):
            tone = sight_tone(base)
            base, start, select = _on_one_clock(base, start, select, tone)
            yardstick = Yardstick(start, tuple(select))
        there = {e.hypothesis.key for e in base.point.effects}
        library = [h for p in physics for h in p.hypotheses(sight) if h.key not in there]
        candidates = round_of(base, select, library, mapper, _part(progress, number))
        ruling = judge(base, candidates, Tried.of(library), samples)
        if not ruling.accepted:
            last = ruling
            break
        point = ruling.rivals[0].candidate.point
        cost = yardstick.cost(point)
        share = (costs[-1] - cost) / yardstick.gap(costs[0])
        objection = _second(base, ruling, share) if number else ""
        extended = base if objection else again(base, point)
        objection = objection or (bent(point.theta, ruling) and bent(extended.point.theta, ruling))
        if objection:
            last = replace(ruling, accepted=False, reason=objection)
            break
        steps.append(Step(ruling, share))
        order.append(number)
        costs.append(cost)
        base, order = _without_superfluous(extended, order, samples)
    if tone is not None and reads_time(base.point) and len(base.point.effects) > 1:
        base, start, select = _on_one_clock(base, start, select, tone)  # the others were in the way when it was set
        base, yardstick = replace(base, point=settle(base.objective, base.point)), Yardstick(start, tuple(select))
    base, order, steps = _reconsider(start, base, order, steps, yardstick, samples, mapper)
    return Found(start, surest(base), tuple(steps), last, tuple(order), first, tuple(select), tone)


def _reconsider(
    start: Baseline, base: Baseline, order: list[int], steps: list[Step], yardstick: Yardstick, samples: tuple[int, int], mapper: Mapper
) -> tuple[Baseline, list[int], list[Step]]:
    """Judge every effect anew with the others in place; one that is not asked for beside them any more is dropped.

    A single one is judged anew as well where the predictor it was chosen with took some of it for noise.
    """
    if not order or (len(order) < 2 and base.limited == "noise" and base.ratio == start.ratio):
        return base, order, steps
    steps, whole = list(steps), yardstick.gap(yardstick.cost(yardstick.base.point))
    for number in list(order):
        at = order.index(number)
        others = order[:at] + order[at + 1 :]
        without, ruling = reconsidered(base, at, steps[number].ruling, yardstick.select, samples, mapper)
        if ruling.accepted and not (others and base.limited == "noise" and _needless(base.objective, ruling, whole)):
            choice = ruling.rivals[0].candidate
            base, steps[number] = replace(base, point=choice.point), replace(steps[number], ruling=ruling)
            order = [*others[: choice.place], number, *others[choice.place :]]
        elif others:
            base, order = without, others
    if len(order) == 1 < len(steps):
        steps[order[0]] = replace(steps[order[0]], share=(whole - yardstick.gap(yardstick.cost(base.point))) / whole)
    return base, order, steps


def _needless(objective: Objective, ruling: Ruling, whole: float) -> bool:
    """Whether an effect closes too little of the ``whole`` gap beside the others to be told."""
    choice = ruling.rivals[0].candidate
    share = float((ruling.nothing.blocks - choice.blocks).sum()) / whole
    return share < WORTH_SAYING or bool(_shaped(objective, choice, share))


def sight_tone(base: Baseline) -> Tone:
    """Return the tallest tone of a baseline's residual."""
    return tones(base.objective.runs, raw(base.objective, base.point))[0]


def _on_one_clock(
    base: Baseline, start: Baseline, select: Sequence[Run], tone: Tone
) -> tuple[Baseline, Baseline, tuple[Run, ...]]:
    """Return both baselines and the selection runs with their clocks set by a tone."""
    runs = aligned(base.objective, base.point, base.objective.runs, tone)
    kept = aligned(base.objective, base.point, select, tone)
    return (
        replace(base, objective=replace(base.objective, runs=runs)), replace(start, objective=replace(start.objective, runs=runs)), kept,
    )


def seen(base: Baseline) -> Machine:
    """Return the machine as it is seen from a baseline, with the tones and peaks of its residual."""
    residuals = raw(base.objective, base.point)
    runs = base.objective.runs
    return machine(base, [t.omega for t in tones(runs, residuals)], peaks(runs, residuals, 2 * bandwidth(runs)))


def quiet(base: Baseline, sight: Machine) -> bool:
    """Whether nothing is left that a further effect could explain: nothing repeats, no tones, no offsets, and noise is white."""
    if base.limited != "noise" or sight.tones:
        return False
    runs, whitened = base.objective.runs, base.objective.whitened(base.point)
    left = repeating(runs, whitened, BAND * bandwidth(runs))
    if left is None or left.total.p < QUIET or base.floor.p_white < QUIET:
        return False
    slow = sum(float((w.mean(0) ** 2).sum()) * len(w) for w in whitened)
    return bool(slow < stats.chi2.isf(QUIET, sum(w.shape[1] for w in whitened)))


@dataclass(frozen=True, slots=True, eq=False)
class Yardstick:
    """The one measure all points are compared with: the first baseline's sum of squares over train and select."""

    base: Baseline
    select: tuple[Run, ...]

    @property
    def least(self) -> float:
        """The cost noise alone would leave; 0 when the noise is not known."""
        return float(sum(r.Y.size for r in self._objective.runs)) if self.base.limited == "noise" else 0.0

    def gap(self, cost: float) -> float:
        """Return how far a cost is above the noise's, at least as much as noise alone makes it vary."""
        return max(cost - self.least, float(np.sqrt(2 * self.least)), 1e-12 * cost)

    @property
    def _objective(self) -> Objective:
        return replace(self.base.objective, runs=(*self.base.objective.runs, *self.select))

    def cost(self, point: Point) -> float:
        """Return the sum of squares with the initial states refitted."""
        return float(sum((w**2).sum() for w in self.whitened(point)))

    def whitened(self, point: Point) -> list[np.ndarray]:
        """Return the whitened residual of every run with the initial states refitted."""
        objective = self._objective
        return objective.whitened(started(objective, point))


def _part(progress: Progress, number: int) -> Progress:
    return lambda what, share: progress(f"effect {number + 1}: {what}", share)


def _second(base: Baseline, ruling: Ruling, share: float) -> str:
    """Return why a further effect is not worth saying, or ""."""
    choice = ruling.rivals[0].candidate
    if share < WORTH_SAYING:
        return f"a further effect ({choice.key}) would close only {100 * share:.1f} % of the gap"
    z = separation(ruling.nothing.blocks, choice.blocks)
    if z < SURE_SECOND and not _confirmed(base, ruling.nothing, choice):
        return f"a further effect ({choice.key}) shows in {z:.1f} standard errors only"
    same = _shaped(base.objective, choice, share)
    if same:
        return f"a further effect ({choice.key}) only mends the shape of {same}"
    return ""


def _confirmed(base: Baseline, nothing: Candidate, choice: Candidate) -> bool:
    """Whether recordings that were not fitted hold a further effect, however few the places where it shows.

    What follows a signal that moves for a moment only gains in one block of many: no spread between blocks can tell that from chance,
    but where the noise is known the likelihood can.
    """
    return base.limited == "noise" and nothing.select - choice.select >= SURE_UNSEEN


def _shaped(objective: Objective, choice: Candidate, share: float) -> str:
    """Return which other effect the one a candidate adds, closing this ``share`` of the gap, is a better shape of; or "".

    Laws are never exact, so what the first leaves runs as its own answer does, and is small: smaller where another place offers it.
    """
    point, site = choice.point, choice.effect.hypothesis.site
    least = [BETTER_SHAPE if e.hypothesis.site == site else BETTER_ELSEWHERE for e in point.effects]
    near = [k for k, limit in enumerate(least) if share < limit and k != choice.place]
    if not near:
        return ""
    whole, own = objective.vector(point), _answer(objective, point, choice.place)
    for k in near:
        other = _answer(objective, point, k) - whole
        like = abs(float(other @ (own - whole))) / max(float(np.linalg.norm(other) * np.linalg.norm(own - whole)), 1e-300)
        if like > ALIKE:
            return point.effects[k].hypothesis.key
    return ""


def _answer(objective: Objective, point: Point, k: int) -> Array:
    """Return the residual with effect ``k`` left out and nothing refitted."""
    return objective.vector(replace(point, effects=point.effects[:k] + point.effects[k + 1 :]))


def _without_superfluous(base: Baseline, order: list[int], samples: tuple[int, int]) -> tuple[Baseline, list[int]]:
    """Drop earlier effects whose absence the newest one makes up for."""
    for k in range(len(base.point.effects) - 2, -1, -1):
        effects = base.point.effects[:k] + base.point.effects[k + 1 :]
        without = settle(base.objective, replace(base.point, effects=effects), 6)
        with_it, lacking = block_costs(base.objective.whitened(base.point)), block_costs(base.objective.whitened(without))
        price = sum(c.free for c in base.point.effects[k].hypothesis.parameters) * float(np.log(samples[0] / base.memory))
        if float((lacking - with_it).sum()) < price + 10 or separation(lacking, with_it, -price) < 2.0:
            base = replace(base, point=without)
            order = order[:k] + order[k + 1 :]
    return base, order
