"""From evidence to a verdict: which fault, how severe, since when. Derived, never stored in place of the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, takewhile

from scipy.special import chdtri

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.detect.combinations import JOINED, weighs_several
from afdsvc.detect.isolation import NONE

TYPICAL = -0.5  # severity a second burst is made for when the first gave none


@dataclass(frozen=True, slots=True)
class FaultVerdict:
    """What a series of decisions amounts to.

    ``fault`` is None while nothing was detected or the evidence does not single one out (then ``weights`` has those it
    may be). ``first_detected_s`` is the time of the first trustworthy detection.
    """

    fault: str | None = None
    severity: Severity | None = None
    first_detected_s: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    detected: bool = False
    trustworthy: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Question:
    """What a burst left open: its name, the faults still possible with their weights, and the severity they share."""

    burst: str
    weights: Mapping[str, float]
    severity: float

    def __str__(self) -> str:
        likely = sorted(self.weights, key=lambda name: -self.weights[name])[:2]
        return f"burst {self.burst} does not decide whether it is {' or '.join(likely)}"


def alarm_decisions(evidence: Sequence[Evidence]) -> list[Evidence]:
    """Return the decisions that raise an alarm: detected by a detector that is trustworthy there."""
    return [e for e in evidence if e.detected and e.trustworthy]


def conclude(evidence: Sequence[Evidence]) -> FaultVerdict:
    """Return the verdict of decisions in the order they were made.

    The alarm is the first trustworthy detection. The fault is the one the newest burst names with certainty (its strongest
    decision: the largest margin over its threshold, of those that weigh several faults at once where any does); its severity, the estimate of smallest standard error in each burst, is pooled over the bursts before that named the same fault,
    as long as they agree. Else the newest weights are reported. A passive detection never overrides the result of a
    burst, and neither does one inside a burst that is not over, or was cut: fewer detectors have judged it than the burst before.
    """
    found = alarm_decisions(evidence)
    if not found:
        reason = "" if any(e.trustworthy for e in _newest(evidence)) else evidence[-1].reason if evidence else ""
        return FaultVerdict(trustworthy=not reason, reason=reason)
    bursts = [list(group) for _, group in groupby((e for e in found if e.burst), key=lambda e: e.burst)] or [found]
    best = [strongest(group) for group in bursts]
    judged = [{e.detector for e in evidence if e.burst == group[0].burst} for group in bursts[-2:]]
    if best[-1] is None and len(judged) > 1 and judged[-1] < judged[-2]:
        bursts, best = bursts[:-1], best[:-1]
    newest = best[-1]
    if newest is None:
        weighted = [e for e in informed(bursts[-1]) if e.weights] or bursts[-1]
        return FaultVerdict(None, None, found[0].seconds, weighted[-1].weights, True)
    both = zip(reversed(best), reversed(bursts), strict=True)
    same = [group for e, group in takewhile(lambda b: b[0] is not None and b[0].fault == newest.fault, both)]
    estimates = [s for s in (_most_precise(group, newest.fault) for group in same) if s is not None]
    return FaultVerdict(newest.fault, _pooled(estimates) if estimates else None, found[0].seconds, newest.weights, True)


def _newest(evidence: Sequence[Evidence]) -> Sequence[Evidence]:
    """Return the decisions on the newest burst, or the newest one between bursts: one detector that cannot judge does not silence others."""
    burst = evidence[-1].burst if evidence else ""
    return [e for e in evidence if e.burst == burst] if burst else evidence[-1:]


def informed(decisions: Sequence[Evidence]) -> Sequence[Evidence]:
    """Return the decisions that weigh several faults at once where any does: the others name a single one whatever it hides."""
    return [e for e in decisions if weighs_several(e.weights, e.parts)] or decisions


def strongest(decisions: Sequence[Evidence]) -> Evidence | None:
    """Return the informed decision that names a fault with the largest margin over its threshold, None when none does.

    One that gives severities comes before one that only bounds them.
    """
    named = [e for e in informed(decisions) if e.fault]
    return max(named, key=lambda e: (e.severity is not None or JOINED in str(e.fault), e.statistic - e.threshold), default=None)


def _most_precise(decisions: Sequence[Evidence], fault: str | None) -> Severity | None:
    """Return the severity with the smallest standard error among the decisions that name this fault, None when none gives any."""
    severities = [e.severity for e in decisions if e.fault == fault and e.severity is not None]
    return min(severities, key=lambda s: s.sd, default=None)


def open_question(decisions: Sequence[Evidence]) -> Question | None:
    """Return what the decisions on one burst leave open: a fault for sure, but which of two or more; None otherwise."""
    verdict = conclude(decisions)
    suspects = {name: w for name, w in verdict.weights.items() if name != NONE}
    if not verdict.detected or verdict.fault or len(suspects) < 2 or verdict.weights.get(NONE, 0.0) > 0.5:
        return None
    severities = [e.severity.value for e in alarm_decisions(decisions) if e.severity]
    severities = severities or [v for e in alarm_decisions(decisions) for name, v in e.parts.items() if name.startswith("together.severity.")]
    return Question(decisions[-1].burst, suspects, severities[-1] if severities else TYPICAL)


def _pooled(newest_first: Sequence[Severity]) -> Severity:
    """Return the weighted mean of independent estimates, newest first, leaving out older ones that do not agree.

    An older estimate joins while all of them together pass the chi-square test of one common value at 1 %: a fault that
    grows is reported at its present value.
    """
    kept = list(newest_first[:1])
    for s in newest_first[1:]:
        mean = _mean([*kept, s])
        spread = sum(((k.value - mean.value) / k.sd) ** 2 for k in (*kept, s))
        if spread > chdtri(len(kept), 0.01):
            break
        kept.append(s)
    return _mean(kept)


def _mean(estimates: Sequence[Severity]) -> Severity:
    if len(estimates) == 1:
        return estimates[0]
    weights = [1 / s.sd**2 for s in estimates]
    value = sum(w * s.value for w, s in zip(weights, estimates, strict=True)) / sum(weights)
    return Severity(value, sum(weights) ** -0.5)


def model_gap(evidence: Sequence[Evidence], bursts: int = 3, kept: Sequence[str] = ()) -> str:
    """Return a notice when the model, not a part, is to be doubted; "" otherwise.

    That is when each of the newest ``bursts`` bursts failed the whiteness gate, or fitted none of the faults, and no decision
    on them names a fault: something is there that neither the model nor the fault list knows.
    ``kept`` are the recordings that `afdsvc explain` can be run on; the newest is named.
    """
    names = list(dict.fromkeys(e.burst for e in reversed(evidence) if e.burst))[:bursts]
    if len(names) < bursts:
        return ""
    by_burst = [[e for e in evidence if e.burst == name] for name in names]
    if any(e.fault and e.trustworthy and e.detected for group in by_burst for e in group):
        return ""
    if not all(any(_doubts_model(e) for e in group) for group in by_burst):
        return ""
    command = f"'afdsvc explain {kept[-1]}' says" if kept else "'afdsvc explain' on the recordings of these bursts finds out"
    return f"model gap suspected: in {bursts} bursts in a row the residual fits neither noise nor any fault; {command} why"


def _doubts_model(e: Evidence) -> bool:
    not_white = not e.trustworthy and e.p_white is not None and e.p_white < 0.01
    return not_white or e.weights.get("none_of_these", 0.0) > 0.5
