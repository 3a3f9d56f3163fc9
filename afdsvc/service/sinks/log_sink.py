"""What happens to a machine, one line each in the service's log: bursts, decisions, alarms, and who did what."""

from __future__ import annotations

import logging

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import AlarmChange, BurstRequest, Finding, Notice, RetuneRequest, RigEvent

log = logging.getLogger(__name__)
LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class LogSink:
    """A sink that writes lines; samples pass it by. Of the decisions on one burst that find nothing, the first is written."""

    def __init__(self, machine: str) -> None:
        self._machine = machine
        self._quiet = ""  # the burst on which nothing was found, already said

    def take(self, message: Message) -> None:
        """Write the line of a message, if it has one."""
        match message.value:
            case Finding(evidence=evidence):
                self._decided(evidence)
            case RigEvent() as event:
                said = f" {event.burst}" * bool(event.burst) + f": {event.cause}" * bool(event.cause)
                log.info("%s: %s%s", self._machine, event.kind.replace("_", " "), said)
            case BurstRequest() as request:
                log.info("%s: burst %s asked for by %s", self._machine, request.burst.name, request.asked_by)
            case RetuneRequest() as request:
                log.info("%s: Q %s for %s asked for by %s", self._machine, request.name, request.found.fault, request.asked_by)
            case Notice(machine, level, sentence):
                log.log(LEVELS.get(level, logging.INFO), "%s", sentence if sentence.startswith(f"{machine}:") else f"{machine}: {sentence}")
            case AlarmChange() as change:
                self._alarm(change)

    def _decided(self, e: Evidence) -> None:
        quiet = e.trustworthy and not e.detected
        if not e.burst or (quiet and e.burst == self._quiet):
            return
        self._quiet = e.burst if quiet else self._quiet
        log.info("%s: %s: %s", self._machine, e.detector, _decision(e))

    def _alarm(self, change: AlarmChange) -> None:
        a, by = change.alarm, f" by {change.who}" if change.who else ""
        why = f": {change.why}" if change.why else ""
        log.warning("%s: alarm %s (%s %s) %s%s%s", self._machine, a.id, a.fault, size(a.severity), change.event, by, why)

    def tick(self) -> None:
        """Pass."""

    def close(self) -> None:
        """Pass."""


def _decision(e: Evidence) -> str:
    """Return a decision in words, with its statistic and threshold."""
    said = e.reason or "not trustworthy" if not e.trustworthy else f"{e.fault or 'a fault, not isolated'} {size(e.severity)}".rstrip() if e.detected else "no fault"
    return f"{said} (statistic {e.statistic:.3g}, threshold {e.threshold:.3g})"


def size(severity: Severity | None) -> str:
    """Return a severity in percent with its standard error, "" for none."""
    return "" if severity is None else f"{100 * severity.value:+.1f} ± {100 * severity.sd:.1f} %"
