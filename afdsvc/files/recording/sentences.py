"""Events as one sentence and a level, for logs."""

from __future__ import annotations

from afdsvc.api.evidence import Evidence
from afdsvc.files.recording.foxglove_log import Level
from afdsvc.wire.messages import EventKind, RigEvent

_WORDS = {
    EventKind.RIG_STARTED: "rig started",
    EventKind.RIG_STOPPED: "rig stopped",
    EventKind.BURST_STARTED: "burst '{burst}' started",
    EventKind.BURST_ENDED: "burst '{burst}' ended",
    EventKind.BURST_ABORTED: "burst '{burst}' cut short",
    EventKind.BURST_REFUSED: "burst '{burst}' refused",
    EventKind.FAULT_INJECTED: "simulated fault set in",
    EventKind.NOTE: "note",
}
_WARNINGS = {EventKind.BURST_ABORTED, EventKind.BURST_REFUSED}


def event_sentence(event: RigEvent) -> tuple[Level, str]:
    """Return level and sentence of an event of a rig."""
    text = _WORDS[event.kind].format(burst=event.burst)
    level = Level.WARNING if event.kind in _WARNINGS else Level.INFO
    return level, f"{text}: {event.cause}" if event.cause else text


def evidence_sentence(evidence: Evidence) -> tuple[Level, str]:
    """Return level and sentence of a decision."""
    e = evidence
    who = e.detector + (f" on {e.output}" if e.output else "")
    if not e.trustworthy:
        return Level.WARNING, f"{who} is not trusted: {e.reason}"
    numbers = f"statistic {e.statistic:.4g}, threshold {e.threshold:.4g}"
    if not e.detected:
        return Level.INFO, f"{who} finds nothing ({numbers})"
    severity = f", severity {e.severity.value:+.3g} +- {e.severity.sd:.2g}" if e.severity else ""
    return Level.ERROR, f"{who} detects {e.fault or 'a change, cause not singled out'}{severity} ({numbers})"


class DecisionLog:
    """Lets a decision through when it differs from the same detector's previous one; one entry per detector is kept."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str, str], tuple[bool, bool, str | None]] = {}

    def worth_telling(self, evidence: Evidence) -> bool:
        """Whether the verdict is new for this machine, detector and output; the first "nothing" is not."""
        who = (evidence.machine, evidence.detector, evidence.output)
        now = (evidence.detected, evidence.trustworthy, evidence.fault)
        changed = self._last.get(who, (False, True, None)) != now
        self._last[who] = now
        return changed
