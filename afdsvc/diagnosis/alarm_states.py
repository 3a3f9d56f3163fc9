"""Transitions of an alarm as functions from alarm to alarm (OPC UA Part 9, section 5: the condition states)."""

from __future__ import annotations

from dataclasses import replace

from afdsvc.api.evidence import Severity
from afdsvc.errors import Refused
from afdsvc.wire.messages import Alarm, AlarmKind


def raised(
    machine: str, fault: str, kind: AlarmKind, sentence: str, t_ns: int, detector: str = "", severity: Severity | None = None
) -> Alarm:
    """Return a new alarm, raised by a detector, or by the monitoring itself (no detector)."""
    by = (detector,) if detector else ()
    return Alarm(f"{machine}/{fault}", machine, fault, t_ns, t_ns, severity=severity, kind=kind, sentence=sentence, raised_by=by)


def returned(alarm: Alarm, again: Alarm) -> Alarm:
    """Return an ended alarm that is raised again: this occurrence is unacknowledged and unconfirmed; a shelved alarm stays shelved."""
    return replace(again, shelved_until_ns=alarm.shelved_until_ns, shelved_by=alarm.shelved_by)


def supported(alarm: Alarm, detector: str, severity: Severity | None, t_ns: int) -> Alarm:
    """Return the alarm with one more decision behind it."""
    by = alarm.raised_by if detector in alarm.raised_by else (*alarm.raised_by, detector)
    return replace(alarm, last_ns=t_ns, count=alarm.count + 1, severity=severity or alarm.severity, raised_by=by)


def opposed(alarm: Alarm, detector: str) -> Alarm:
    """Return the alarm without a detector that has decided otherwise."""
    return replace(alarm, raised_by=tuple(d for d in alarm.raised_by if d != detector))


def ended(alarm: Alarm, t_ns: int, latch: bool) -> Alarm:
    """Return the alarm whose condition no longer holds; it stays latched where the site wants that."""
    return replace(alarm, active=False, ended_ns=t_ns, latched=latch, suppressed="", cause="", raised_by=())


def acknowledged(alarm: Alarm, who: str, comment: str) -> Alarm:
    """Return the alarm as acknowledged."""
    return replace(alarm, acknowledged=True, acknowledged_by=who, comment=comment)


def confirmed(alarm: Alarm, who: str, comment: str) -> Alarm:
    """Return the alarm as confirmed; raises `Refused` while it is unacknowledged."""
    if not alarm.acknowledged:
        raise Refused(f"alarm '{alarm.id}' is not acknowledged; acknowledge it before confirming")
    return replace(alarm, confirmed=True, confirmed_by=who, comment=comment or alarm.comment)


def unlatched(alarm: Alarm) -> Alarm:
    """Return the alarm without its latch; raises `Refused` while it is active or unacknowledged."""
    if alarm.active:
        raise Refused(f"alarm '{alarm.id}' still holds; it can be reset when its condition is over")
    if not alarm.acknowledged:
        raise Refused(f"alarm '{alarm.id}' is not acknowledged; acknowledge it before resetting")
    return replace(alarm, latched=False)


def shelved(alarm: Alarm, who: str, until_ns: int) -> Alarm:
    """Return the alarm shelved by a person until a time."""
    return replace(alarm, shelved_until_ns=until_ns, shelved_by=who)


def unshelved(alarm: Alarm) -> Alarm:
    """Return the alarm back from the shelf."""
    return replace(alarm, shelved_until_ns=0, shelved_by="")


def consequence(alarm: Alarm, cause: str) -> Alarm:
    """Return the alarm as a consequence of another ("" makes it stand for itself again)."""
    return replace(alarm, cause=cause, suppressed=f"follows from {cause}" if cause else "")
