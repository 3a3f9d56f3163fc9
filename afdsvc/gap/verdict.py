"""The verdict: consistent, a parameter off, physics left out, unexplained, or too little excitation to tell."""

from __future__ import annotations

from dataclasses import dataclass

from afdsvc.gap.explanation import Named, Remainder
from afdsvc.gap.forward import Found
from afdsvc.gap.naming import is_change
from afdsvc.gap.repeating import Repeating
from afdsvc.gap.verify import Explained

ENOUGH = 0.8  # explained fraction below which names are withdrawn
SOMETHING = 1e-6  # p-value of what repeats below which something is there


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict with its reasons; ``tells_names`` says whether the names found may be told as such."""

    verdict: str
    sentences: tuple[str, ...]
    tells_names: bool = False
    extra: tuple[Named, ...] = ()
    remainder: Remainder | None = None


def judged(found: Found, done: Explained) -> Judgement:
    """Return the verdict on a finished search."""
    if not found.steps:
        return _nothing_named(done)
    if done.fraction + 2 * done.sd < ENOUGH:
        return Judgement(
            "unexplained",
            (f"only {100 * done.fraction:.0f} % of the gap is explained by the best hypotheses; none of them may be claimed",),
        )
    hypotheses = [e.hypothesis for e in found.end.point.effects]
    verdict = "parameter_change" if is_change(hypotheses) else "omitted_physics"
    return Judgement(verdict, (f"{100 * min(done.fraction, 1.0):.0f} % of the gap is explained",), True)


def _nothing_named(done: Explained) -> Judgement:
    left = done.before
    if left is None or not _significant(left):
        return Judgement("consistent", ("nothing is left in the recordings but noise",))
    return Judgement("unexplained", (f"something repeats with the excitation (p = {left.total.p:.1g}) that no hypothesis explains",))


def _significant(left: Repeating) -> bool:
    return left.total.p < SOMETHING
