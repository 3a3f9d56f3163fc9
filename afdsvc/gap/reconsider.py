"""Every name judged again with everything else in place: the first choice was made while later effects were still missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from afdsvc.gap.baseline import Baseline
from afdsvc.gap.judge import Rival, Ruling, Tried, judge
from afdsvc.gap.objective import Borrowed, borrowed, tangent
from afdsvc.gap.runs import Run
from afdsvc.gap.search import Candidate, Mapper, evaluate
from afdsvc.gap.settle import settle
from afdsvc.gap.simulator import Effect

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
    found = list(mapper(partial(_swapped, base, kept, select, known, nothing), _contenders(point.effects[number], kept, ruling)))
    new = judge(without, [nothing, *found], Tried.of(c.hypothesis for c in found if c.hypothesis), samples)
    return without, replace(new, beaten=_all_beaten(new, ruling)) if new.accepted else new


def _contenders(current: Effect, kept: Sequence[Effect], ruling: Ruling) -> list[Effect]:
    """Return the effect itself and its look-alikes as they were fitted, those in use elsewhere left out."""
    used = {e.hypothesis.key for e in (*kept, current)}
    ranked = [*ruling.rivals, *ruling.beaten]
    others = [r.candidate.effect for r in ranked if r.candidate.key not in used]
    return [current, *others[: max(RIVALS - 1, 0)]]


def _swapped(
    base: Baseline, kept: tuple[Effect, ...], select: Sequence[Run], known: Borrowed | None, nothing: Candidate, effect: Effect
) -> Candidate:
    point = settle(base.objective, replace(base.point, effects=(*kept, effect)), PASSES, known=known)
    return evaluate(base, select, effect.hypothesis, point, nothing)


def _all_beaten(new: Ruling, old: Ruling) -> tuple[Rival, ...]:
    """Return the beaten of this ruling and of the one before, each once."""
    known = {r.candidate.key for r in (*new.rivals, *new.beaten)}
    return (*new.beaten, *(r for r in old.beaten if r.candidate.key not in known))

