"""The alarms of a site: raised and ended by evidence with bounded debounce and hysteresis, handled by operators, published on change.

Transitions are functions from alarm to alarm (OPC UA Part 9, section 5: the condition states).

An alarm's id is ``<machine>/<fault>``; a fault that could not be singled out is ``unnamed``. What is not heard of (a machine
that is gone, a stream that is stale) raises nothing and ends nothing: silence is not evidence.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.errors import BadInput, Refused
from afdsvc.wire.messages import Alarm, AlarmChange, AlarmKind, Finding

UNNAMED = "unnamed"
MINUTE = 60_000_000_000


@dataclass(frozen=True, slots=True)
class Policy:
    """How eager alarms are: decisions in a row that raise one, quiet decisions in a row (per detector that raised it) that end
    it, whether an ended alarm stays latched, and for how many minutes at most it can be shelved."""

    raise_after: int = 1
    clear_after: int = 2
    latch: bool = False
    shelve_minutes: float = 24 * 60


Tell = Callable[[AlarmChange], None]


class AlarmBook:
    """Takes decisions and people's requests from any thread; ``tell`` hears of every change, in order."""

    def __init__(self, policy: Policy = Policy(), tell: Tell = lambda change: None) -> None:  # frozen
        self._policy, self._tell = policy, tell
        self._alarms: dict[str, Alarm] = {}
        self._pending: dict[str, int] = {}  # supporting decisions of what is not raised yet
        self._quiet: dict[tuple[str, str], int] = {}  # decisions against an alarm by a detector that raised it
        self._lock = threading.RLock()

    @property
    def alarms(self) -> dict[str, Alarm]:
        """Every alarm by id."""
        with self._lock:
            return dict(self._alarms)

    def of(self, machine: str) -> tuple[Alarm, ...]:
        """Return the alarms of one machine that are to stay on the list."""
        return tuple(a for a in self.alarms.values() if a.machine == machine and a.retained)

    def restore(self, alarms: Iterable[Alarm], t_ns: int) -> None:
        """Take up what an earlier run left; troubles of that run's own watching are over."""
        with self._lock:
            self._alarms.update((a.id, a) for a in alarms)
            for alarm in [a for a in self._alarms.values() if a.active and a.kind is not AlarmKind.FAULT]:
                self._set(ended(alarm, t_ns, False), "ended", t_ns, why="the service was restarted")

    def take(self, finding: Finding, sentence: str = "") -> Alarm | None:
        """Return the alarm a decision raised or supported; None when it raised none."""
        e = finding.evidence
        if not e.trustworthy:
            return None
        with self._lock:
            id = f"{e.machine}/{e.fault or UNNAMED}" if e.detected else ""
            self._oppose(e, id, finding.t_ns)
            return self._support(id, e, sentence, finding.t_ns) if id else None

    def condition(self, machine: str, name: str, kind: AlarmKind, holds: bool, sentence: str, t_ns: int) -> None:
        """Raise or end an alarm about the watching itself, or a notice; nothing happens when it stands so already."""
        id = f"{machine}/{name}"
        with self._lock:
            known = self._alarms.get(id)
            if holds and not (known and known.active):
                self._raise(raised(machine, name, kind, sentence, t_ns))
            elif known and known.active and not holds:
                self._end(known, t_ns, sentence)

    def group(self, machine: str, leading: str | None, t_ns: int) -> None:
        """Make the other active fault alarms of a machine consequences of the leading one.

        ``leading`` is the fault the evidence as a whole names; while it names none, what was grouped stays so as long as its
        cause holds. While the watching itself is in trouble, that leads.
        """
        with self._lock:
            active = [a for a in self._alarms.values() if a.machine == machine and a.active]
            trouble = next((a.id for a in active if a.kind is AlarmKind.SYSTEM), "")
            lead = trouble or (f"{machine}/{leading}" if leading else "")
            holding = {a.id for a in active}
            for a in active:
                cause = (lead or a.cause) if a.kind is AlarmKind.FAULT and a.id != lead else ""
                cause = cause if cause in holding else ""
                if a.cause != cause:
                    why = f"follows from {cause}" if cause else "stands for itself"
                    self._set(consequence(a, cause), "grouped", t_ns, why=why)

    def acknowledge(self, id: str, who: str, comment: str = "", t_ns: int = 0, seen_ns: int | None = None) -> Alarm:
        """Note who has seen an alarm.

        ``seen_ns`` is the beginning of the occurrence the person looked at: one that came later is not acknowledged unseen.
        Raises `BadInput` listing the ids there are, `Refused` for another occurrence.
        """
        with self._lock:
            alarm = self._named(id)
            if seen_ns is not None and alarm.since_ns != seen_ns:
                raise Refused(f"alarm '{id}' has occurred again since; look at it before acknowledging")
            return self._set(acknowledged(alarm, who, comment), "acknowledged", t_ns, who, comment)

    def confirm(self, id: str, who: str, comment: str, t_ns: int) -> Alarm:
        """Note who has dealt with an alarm; raises `Refused` before it is acknowledged."""
        with self._lock:
            return self._set(confirmed(self._named(id), who, comment), "confirmed", t_ns, who, comment)

    def reset(self, id: str, who: str, comment: str, t_ns: int) -> Alarm:
        """Release a latched alarm; raises `Refused` while it is active or unacknowledged."""
        with self._lock:
            return self._set(unlatched(self._named(id)), "reset", t_ns, who, comment)

    def shelve(self, id: str, who: str, minutes: float, why: str, t_ns: int) -> Alarm:
        """Put an alarm aside for a time, with a reason; raises `BadInput` for a time that makes no sense."""
        if not 0 < minutes <= self._policy.shelve_minutes:
            raise BadInput(f"shelving for {minutes:g} minutes; expected more than 0 and at most {self._policy.shelve_minutes:g}")
        if not why.strip():
            raise BadInput(f"alarm '{id}' cannot be shelved without a reason")
        with self._lock:
            self._pending.pop(id, None)
            return self._set(shelved(self._named(id), who, t_ns + round(minutes * MINUTE)), "shelved", t_ns, who, why)

    def unshelve(self, id: str, who: str, t_ns: int) -> Alarm:
        """Take an alarm from the shelf."""
        with self._lock:
            return self._set(unshelved(self._named(id)), "unshelved", t_ns, who)

    def tick(self, t_ns: int) -> None:
        """Take from the shelf what has lain there long enough; to be called now and then."""
        with self._lock:
            for alarm in [a for a in self._alarms.values() if 0 < a.shelved_until_ns <= t_ns]:
                self._set(unshelved(alarm), "unshelved", t_ns, why="the time is over")

    def _support(self, id: str, e: Evidence, sentence: str, t_ns: int) -> Alarm | None:
        self._quiet[id, e.detector] = 0
        alarm = self._alarms.get(id)
        if alarm is None or not alarm.active:
            self._pending[id] = self._pending.get(id, 0) + 1
            if self._pending[id] < self._policy.raise_after:
                return None
            fault = e.fault or UNNAMED
            return self._raise(raised(e.machine, fault, AlarmKind.FAULT, sentence, t_ns, e.detector, e.severity))
        more = supported(alarm, e.detector, e.severity, t_ns, sentence)
        if more.raised_by != alarm.raised_by:
            return self._set(more, "supported", t_ns, why=f"{e.detector} agrees")
        self._alarms[id] = more
        return more

    def _oppose(self, e: Evidence, supports: str, t_ns: int) -> None:
        """Count a decision that does not support an alarm of its machine against it."""
        for id in [i for i in self._pending if i.startswith(f"{e.machine}/") and i != supports]:
            del self._pending[id]
        for alarm in list(self._alarms.values()):
            if alarm.machine == e.machine and alarm.active and alarm.id != supports and e.detector in alarm.raised_by:
                self._against(alarm, e.detector, t_ns)

    def _against(self, alarm: Alarm, detector: str, t_ns: int) -> None:
        key = (alarm.id, detector)
        self._quiet[key] = self._quiet.get(key, 0) + 1
        if self._quiet[key] < self._policy.clear_after:
            return
        left = opposed(alarm, detector)
        self._alarms[alarm.id] = left
        if not left.raised_by:
            self._end(left, t_ns, "no detector that raised it detects it any more")

    def _raise(self, alarm: Alarm) -> Alarm:
        self._pending.pop(alarm.id, None)
        known = self._alarms.get(alarm.id)
        return self._set(returned(known, alarm) if known else alarm, "raised", alarm.since_ns, why=alarm.sentence)

    def _end(self, alarm: Alarm, t_ns: int, why: str) -> None:
        latch = self._policy.latch and alarm.kind is AlarmKind.FAULT
        self._set(ended(alarm, t_ns, latch), "ended", t_ns, why=why)

    def _set(self, alarm: Alarm, event: str, t_ns: int, who: str = "", why: str = "") -> Alarm:
        self._alarms[alarm.id] = alarm
        self._tell(AlarmChange(alarm, event, t_ns, who, why))
        return alarm

    def _named(self, id: str) -> Alarm:
        if id not in self._alarms:
            raise BadInput(f"no alarm '{id}'; there are {', '.join(self._alarms) or 'none'}")
        return self._alarms[id]


def raised(
    machine: str, fault: str, kind: AlarmKind, sentence: str, t_ns: int, detector: str = "", severity: Severity | None = None
) -> Alarm:
    """Return a new alarm, raised by a detector, or by the monitoring itself (no detector)."""
    by = (detector,) if detector else ()
    return Alarm(f"{machine}/{fault}", machine, fault, t_ns, t_ns, severity=severity, kind=kind, sentence=sentence, raised_by=by)


def returned(alarm: Alarm, again: Alarm) -> Alarm:
    """Return an ended alarm that is raised again: this occurrence is unacknowledged and unconfirmed; a shelved alarm stays shelved."""
    return replace(again, shelved_until_ns=alarm.shelved_until_ns, shelved_by=alarm.shelved_by)


def supported(alarm: Alarm, detector: str, severity: Severity | None, t_ns: int, sentence: str = "") -> Alarm:
    """Return the alarm with one more decision behind it, which it says from now on."""
    by = alarm.raised_by if detector in alarm.raised_by else (*alarm.raised_by, detector)
    return replace(alarm, last_ns=t_ns, count=alarm.count + 1, severity=severity or alarm.severity, raised_by=by, sentence=sentence or alarm.sentence)


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
