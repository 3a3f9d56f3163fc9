"""Alarms as operators expect them: raised by evidence, counted, acknowledged by a person, never silently dropped."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from afdsvc.api.evidence import Evidence
from afdsvc.errors import BadInput
from afdsvc.wire.messages import Alarm, Finding

UNNAMED = "unnamed"


@dataclass
class AlarmBook:
    """The alarms of one site by id ``<machine>/<fault>``; a fault that could not be singled out is ``unnamed``."""

    alarms: dict[str, Alarm] = field(default_factory=dict)
    _raised_by: dict[str, set[str]] = field(default_factory=dict)

    def take(self, finding: Finding) -> Alarm | None:
        """Return the alarm a decision raised or supported; None when it raised none.

        An alarm stays active until every detector that raised it has decided otherwise.
        """
        e = finding.evidence
        if e.detected and e.trustworthy:
            return self._raise(e, finding.t_ns)
        if e.trustworthy:
            self._quiet(e)
        return None

    def acknowledge(self, id: str, who: str, comment: str = "") -> Alarm:
        """Note who has seen an alarm; raises `BadInput` listing the ids there are."""
        if id not in self.alarms:
            raise BadInput(f"no alarm '{id}'; there are {', '.join(self.alarms) or 'none'}")
        seen = replace(self.alarms[id], acknowledged=True, acknowledged_by=who, comment=comment)
        self.alarms[id] = seen
        return seen

    def of(self, machine: str) -> tuple[Alarm, ...]:
        """Return the alarms of one machine that are active or not acknowledged."""
        return tuple(a for a in self.alarms.values() if a.machine == machine and (a.active or not a.acknowledged))

    def _raise(self, e: Evidence, t_ns: int) -> Alarm:
        id = f"{e.machine}/{e.fault or UNNAMED}"
        known = self.alarms.get(id)
        if known is None:
            alarm = Alarm(id, e.machine, e.fault or UNNAMED, t_ns, t_ns, severity=e.severity)
        else:
            alarm = replace(known, last_ns=t_ns, count=known.count + 1, active=True, severity=e.severity or known.severity)
        self.alarms[id] = alarm
        self._raised_by.setdefault(id, set()).add(e.detector)
        return alarm

    def _quiet(self, e: Evidence) -> None:
        for id, alarm in self.alarms.items():
            if alarm.machine == e.machine and alarm.active:
                self._raised_by[id].discard(e.detector)
                if not self._raised_by[id]:
                    self.alarms[id] = replace(alarm, active=False)
