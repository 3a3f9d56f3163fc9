"""From evidence to a verdict: which fault, how severe, since when. Derived, never stored in place of the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from afdsvc.api.evidence import Evidence, Severity


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a series of decisions amounts to.

    ``fault`` is None while nothing was detected or the evidence does not single one out (then ``weights`` tells between
    which it hangs). ``first_detected_s`` is the time of the first trustworthy detection.
    """

    fault: str | None = None
    severity: Severity | None = None
    first_detected_s: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    detected: bool = False
    trustworthy: bool = True
    reason: str = ""


def alarms(evidence: Sequence[Evidence]) -> list[Evidence]:
    """Return the decisions that raise an alarm: detected by a detector that is trustworthy there."""
    return [e for e in evidence if e.detected and e.trustworthy]


def conclude(evidence: Sequence[Evidence]) -> Verdict:
    """Return the verdict of decisions in the order they were made.

    The alarm is the first trustworthy detection. Fault and severity come from the newest trustworthy decision that names
    one with certainty, the strongest (largest margin over its threshold) of the newest burst; else the newest weights. A
    passive detection, which excites nothing, never overrides what a burst has told.
    """
    found = alarms(evidence)
    untrusted = [e for e in evidence if not e.trustworthy]
    if not found:
        reason = untrusted[-1].reason if untrusted and untrusted[-1] is evidence[-1] else ""
        return Verdict(trustworthy=not reason, reason=reason)
    told = [e for e in found if e.burst] or found
    newest = [e for e in told if e.burst == told[-1].burst]
    named = [e for e in newest if e.fault and e.severity]
    if named:
        best = max(named, key=lambda e: e.statistic - e.threshold)
        return Verdict(best.fault, best.severity, found[0].seconds, best.weights, True)
    weighted = [e for e in newest if e.weights] or newest
    return Verdict(None, None, found[0].seconds, weighted[-1].weights, True)
