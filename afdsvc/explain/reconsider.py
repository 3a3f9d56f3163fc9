"""Every name judged again with everything else in place: the first choice was made while later effects were still missing.

Effects at one port act one after the other (what is cut and then delayed is not what is delayed and then cut), in an order the
search did not choose; here every one is tried before and behind the others of its port.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from afdsvc.api.physics import Hypothesis
from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.judge import Rival, Ruling, Tried, judge
from afdsvc.explain.objective import Borrowed, borrowed, tangent
from afdsvc.explain.search import Candidate, Mapper, evaluate
from afdsvc.explain.settle import full_cost, settle
from afdsvc.explain.simulator import Effect

RIVALS = 7  # how many look-alikes of an effect are tried in its place
PASSES = 8


def reconsidered(
    base: Baseline, number: int, ruling: Ruling, select: Sequence[Run], samples: tuple[int, int], mapper: Mapper = map
) -> tuple[Baseline, Ruling]:
    """Return the end of the search without effect ``number`` and the ruling on what is to take its place there: itself, one of
    its look-alikes, or nothing."""
    point = base.point
    kept = point.effects[:number] + point.effects[number + 1 :]
    without = replace(base, point=settle(base.objective, replace(point, effects=kept), PASSES))
    nothing = evaluate(without, select, None, without.point)
    known = borrowed(tangent(base.objective, without.point)) if base.limited == "noise" else None
    tried = partial(_swapped, base, kept, select, known, nothing, number)
    found = list(mapper(tried, _contenders(point.effects[number], kept, ruling)))
    new = judge(without, [nothing, *found], Tried.of(c.hypothesis for c in found if c.hypothesis), samples)
    return without, replace(new, beaten=_all_beaten(new, ruling)) if new.accepted else new


def _contenders(current: Effect, kept: Sequence[Effect], ruling: Ruling) -> list[Effect]:
    """Return the effect itself and its look-alikes as they were fitted, those in use elsewhere left out."""
    used = {e.hypothesis.key for e in (*kept, current)}
    ranked = [*ruling.rivals, *ruling.beaten]
    others = [r.candidate.effect for r in ranked if r.candidate.key not in used]
    return [current, *others[: max(RIVALS - 1, 0)]]


def _swapped(
    base: Baseline, kept: tuple[Effect, ...], select: Sequence[Run], known: Borrowed | None, nothing: Candidate, number: int, effect: Effect
) -> Candidate:
    """Return the candidate with ``effect`` as number ``number`` among the kept, or where else it does best if the order matters."""
    in_order = [(*kept[:k], effect, *kept[k:]) for k in _places(kept, effect, number)]
    points = [settle(base.objective, replace(base.point, effects=effects), PASSES, known=known) for effects in in_order]
    best = min(points, key=lambda p: full_cost(base.objective, p)) if len(points) > 1 else points[0]
    return evaluate(base, select, effect.hypothesis, best, nothing)


def _places(kept: Sequence[Effect], effect: Effect, number: int) -> list[int]:
    """Return where among the kept an effect is tried: at its number, and on either side of those it acts in series with."""
    series = [k for k, other in enumerate(kept) if _in_series(effect.hypothesis, other.hypothesis)]
    return list(dict.fromkeys([number, *series, *(k + 1 for k in series)]))


def _in_series(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether one of two laws changes what the other reads; forces add up, and do not."""
    return a.stage == b.stage != "force" and not (set(a.writes).isdisjoint(b.reads) and set(b.writes).isdisjoint(a.reads))


def _all_beaten(new: Ruling, old: Ruling) -> tuple[Rival, ...]:
    """Return the beaten of this ruling and of the one before, each once."""
    known = {r.candidate.key for r in (*new.rivals, *new.beaten)}
    return (*new.beaten, *(r for r in old.beaten if r.candidate.key not in known))

