"""The verdict: what the gap test and the search together allow to be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.evidence import p_value_text
from afdsvc.explain.gap.finding import Gap
from afdsvc.explain.search.forward import Found, Round
from afdsvc.explain.search.ranking import Candidate, is_constant, look_alikes, vote_shares
from afdsvc.explain.simulate.nominal import PARAMETER


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One name: its candidate, how sure it is among its look-alikes, which effect it explains (from 1), its share of the gap."""

    candidate: Candidate
    weight: float
    effect: int
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The verdict in one word, the claims (first of an effect first), sentences for people, and the gap before and after.

    ``explained`` is the share of the gap that is closed, with its standard deviation over the blocks.
    """

    verdict: str
    claims: tuple[Claim, ...]
    sentences: tuple[str, ...]
    gap: Gap
    remainder: Gap | None
    explained: tuple[float, float]


def verdict(found: Found, gap: Gap, remainder: Gap | None) -> Verdict:
    """Return the verdict of a search, the gap before it and the one that remains after it."""
    accepted = [s for s in found.steps if s.accepted]
    explained = _explained(found)
    implausible, complete = _implausible(found), _complete(found, remainder, explained)
    if not accepted or complete < 1 - found.problem.settings.sure:
        word, sentences = _nothing(found, gap, implausible)
        return Verdict(word, (), sentences, gap, remainder, explained)
    open_ended = remainder is not None and remainder.present
    uncertain, even = found.problem.settings.uncertain, found.problem.settings.probable
    most = [min(complete, max(s.confirmed, even), uncertain if implausible or s.reason or (open_ended and k) else 1.0) for k, s in enumerate(accepted)]
    claims = [c for k, s in enumerate(accepted) for c in _claims(s, k + 1, most[k], found)]
    firsts = [next(c for c in claims if c.effect == k) for k in range(1, len(accepted) + 1)]
    word = "parameter_change" if all(is_constant(c.candidate.hypothesis) for c in firsts) else "omitted_physics"
    limit = (f"the named effects close {100 * complete:.0f} % of what can be explained; no name is surer than that",) if complete < 0.995 else ()
    doubts = tuple(f"{s.reason}; the recordings held out confirm it: no name is certain" for s in accepted if s.reason)
    doubts += tuple(f"{s.candidates[0].hypothesis.title}: the recordings held out do not confirm it beside what was found before" for s in accepted if s.confirmed < even)
    return Verdict(word, tuple(claims), (*_rest(gap, remainder, explained), *limit, *doubts, *implausible), gap, remainder, explained)


DOUBT = 0.1  # share of the residual a flexible model predicts above which "consistent" is not said


def _nothing(found: Found, gap: Gap, implausible: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    last = found.steps[-1] if found.steps else None
    if last is None:
        return "consistent", ("the residual is rounding: recording and simulation agree",)
    nearest = f"{last.candidates[0].hypothesis.title} closes too little of what can be explained" if last.accepted else last.reason
    stop = (f"the search stopped: {nearest}",)
    if gap.present or gap.total > DOUBT:
        return "unexplained", (gap.sentence, *stop, *implausible)
    if implausible:
        return "parameter_change", (gap.sentence, *implausible)
    return "consistent", (gap.sentence, *stop)


def _claims(step: Round, number: int, most: float, found: Found) -> list[Claim]:
    settings = found.problem.settings
    alike = look_alikes(step.candidates, settings, step.limited)
    w = vote_shares(alike, settings, step.limited)
    order = [0, *sorted((k for k in range(1, len(alike)) if w[k] >= 1 - settings.sure), key=lambda k: -w[k])]
    return [Claim(alike[k], min(float(w[k]), most), number, alike[k].evidence.explained) for k in order]


def _implausible(found: Found) -> tuple[str, ...]:
    """Return a sentence where numbers of the final model are far from the stated ones; those that a law changes are so at some time only."""
    limit, point, entries = found.problem.settings.implausible, list(found.end.values())[-1].point, found.problem.nominal.entries
    changed = [s.index for e in point.effects for s in e.hypothesis.writes if s.kind == "p"]
    far = any(abs(t) > limit and not (e.matrix == PARAMETER and e.row in changed) for t, e in zip(point.theta, entries, strict=True))
    return (f"numbers of the model are more than {limit:g} stated standard deviations from what is stated: no name is certain",) if far else ()


def _complete(found: Found, remainder: Gap | None, explained: tuple[float, float]) -> float:
    """Return how much of what can be explained the named effects close: what no name closes may be another law in their place.

    Where the noise is known, all above it can be explained (the upper end of the 95 % interval counts); else what a flexible model
    predicts of the remainder, where it is tested or the recordings are too short for a test.
    """
    share, sd = explained
    if found.problem.weighting.measured:
        return min(1.0, share + 2 * sd)
    if remainder is None or (remainder.enough and not remainder.present):
        return 1.0
    return share / max(share + max(remainder.total, 0.0) * (1 - share), 1e-300)


def _explained(found: Found) -> tuple[float, float]:
    """Return the part of the gap that is closed at the decision horizon, by blocks left out, and its standard deviation: that of a ratio,
    for blocks that hold more of the gap close more of it (Cochran, Sampling Techniques, 1977, equation 6.5)."""
    e = found.evidence
    before, part = e.before.sum(1), e.explained
    closed = before - e.after.sum(1)
    gap = closed.sum() / part if part > 0 and closed.sum() > 0 else max(before.sum(), 1e-300)
    spread = np.sqrt(len(closed)) * (closed - part * before).std(ddof=1) if len(closed) > 1 else 0.0
    return part, float(spread / gap)


def _rest(gap: Gap, remainder: Gap | None, explained: tuple[float, float]) -> tuple[str, ...]:
    left = remainder if remainder is not None and remainder.present else None
    said = f"closes {'more than 99' if explained[0] > 0.99 and left else f'{100 * explained[0]:.0f}'} % of the gap"
    if gap.total > 0:
        said += f"; a flexible model without physics predicts {100 * gap.total:.0f} % of the residual's power"
    if left is None:
        return (said,)
    follows = ", ".join(name for name, share in left.depends_on[:2] if share > 0)
    return (said, f"the remainder is not noise ({p_value_text(left.p_value)}){' and follows ' + follows if follows else ''}")
