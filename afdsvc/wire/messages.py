"""Messages other than samples, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.retuning import DiagnosedFault, Tuning
from afdsvc.api.signals import Block, Channel


class EventKind(StrEnum):
    """What can happen on a rig; only simulators say `fault_injected`, the truth a demonstration is judged by."""

    RIG_STARTED = "rig_started"
    RIG_STOPPED = "rig_stopped"
    BURST_STARTED = "burst_started"
    BURST_ENDED = "burst_ended"
    BURST_ABORTED = "burst_aborted"
    BURST_REFUSED = "burst_refused"
    FAULT_INJECTED = "fault_injected"
    NOTE = "note"
    RETUNED = "retuned"
    RESTORED = "restored"
    RETUNE_REFUSED = "retune_refused"


@dataclass(frozen=True, slots=True)
class RigEvent:
    """Something that happened on a rig at sample ``k`` of its session; ``burst`` names the burst, or the Q, ``cause`` is one sentence."""

    machine: str
    session: str
    t_ns: int
    kind: EventKind
    k: int = 0
    burst: str = ""
    cause: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class BurstRequest:
    """A burst to be played from sample ``start`` on (at once when it has passed); the rig ends it when the lease [s] runs
    out without renewal. ``session`` is the rig's the request is meant for ("": any), ``k`` the newest sample its sender had seen."""

    machine: str
    burst: Burst
    lease: float
    asked_by: str
    t_ns: int
    start: int = 0
    session: str = ""
    k: int = 0


@dataclass(frozen=True, slots=True)
class BurstReply:
    """Accepted, or refused with the reason."""

    accepted: bool
    burst: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RetuneRequest:
    """A Q to act beside the running controller under the name ``name``; the reply is a `BurstReply`.

    It was proved for the severities of ``found`` (``proof`` says what, in one sentence); the rig restores the machine when the lease [s]
    runs out without renewal. ``session`` and ``k`` as in `BurstRequest`.
    """

    machine: str
    name: str
    tuning: Tuning
    found: DiagnosedFault
    lease: float
    asked_by: str
    t_ns: int
    session: str = ""
    k: int = 0
    proof: str = ""


@dataclass(frozen=True, slots=True)
class BurstStop:
    """The burst, or the Q (any, when unnamed), is to end now; the reply is a `BurstReply`."""

    machine: str
    reason: str
    asked_by: str
    burst: str = ""


@dataclass(frozen=True, slots=True)
class Lease:
    """Whoever asked for the burst, or the Q, of this name is still there and will be for so many seconds."""

    machine: str
    burst: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Receipt:
    """What the service has recorded of a machine, as (session, first sample, sample after the last)."""

    machine: str
    ranges: tuple[tuple[str, int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class RigDescription:
    """What a rig says of itself; ``limits`` is None for a machine that can only be watched.

    ``samples``, ``late`` and ``head_room`` (share of the sample period the loop did not use) are sent as a heartbeat.
    """

    machine: str
    session: str
    t_ns: int
    dt: float
    channels: tuple[Channel, ...]
    limits: Limits | None = None
    controller: str = ""
    site: str = ""
    model: str = ""
    version: str = ""
    driver: str = ""
    samples: int = 0
    late: int = 0
    head_room: float = 1.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Evidence with the session it belongs to and the Unix time [ns] of the sample it was decided at."""

    evidence: Evidence
    session: str
    t_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """The whitened residual of a block of samples, as a block of its own."""

    block: Block


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence of the service about a machine; ``level`` is info, warning or error."""

    machine: str
    level: str
    sentence: str
    t_ns: int


class AlarmKind(StrEnum):
    """What an alarm is about: a fault of the machine, a fault of the monitoring (a dead sensor), or a notice."""

    FAULT = "fault"
    SYSTEM = "system"
    NOTICE = "notice"


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm in the words of OPC UA Part 9: since when, how often supported, whether still, and who did what about it.

    ``active`` says the condition holds, ``acknowledged`` that somebody has seen it, ``confirmed`` that somebody has dealt with
    it. A ``latched`` alarm has ended and waits to be reset. ``shelved_until_ns`` (0: not shelved) and ``shelved_by`` are a
    person's doing, ``suppressed`` (why, "" otherwise) is the service's; ``cause`` is the id of the alarm it follows from,
    ``raised_by`` the detectors that support it.
    """

    id: str
    machine: str
    fault: str
    since_ns: int
    last_ns: int
    count: int = 1
    active: bool = True
    severity: Severity | None = None
    acknowledged: bool = False
    acknowledged_by: str = ""
    comment: str = ""
    kind: AlarmKind = AlarmKind.FAULT
    confirmed: bool = False
    confirmed_by: str = ""
    latched: bool = False
    shelved_until_ns: int = 0
    shelved_by: str = ""
    suppressed: str = ""
    cause: str = ""
    ended_ns: int = 0
    sentence: str = ""
    raised_by: tuple[str, ...] = ()

    @property
    def retained(self) -> bool:
        """Whether it stays on the list: it is active, latched or unacknowledged (a notice ends by itself)."""
        return self.active or self.latched or (not self.acknowledged and self.kind is not AlarmKind.NOTICE)

    @property
    def announced(self) -> bool:
        """Whether it is to call for attention now: on the list, neither shelved nor suppressed."""
        return self.retained and not self.shelved_until_ns and not self.suppressed


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """What happened to an alarm, when, by whom ("" for the service itself) and why; ``alarm`` is how it stands afterwards."""

    alarm: Alarm
    event: str
    t_ns: int
    who: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class MachineStatus:
    """State of one machine in the service; ``reason`` explains any state but running, ``tuning`` says that a Q is proposed, or acts."""

    machine: str
    state: str
    session: str = ""
    reason: str = ""
    blocks: int = 0
    lost_blocks: int = 0
    late: int = 0
    head_room: float = 1.0
    block_age: float = 0.0
    burst: str = ""
    next_burst: float = 0.0
    trustworthy: bool = True
    alarms: tuple[Alarm, ...] = ()
    tuning: str = ""


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """How the service is; ``recording_failure`` says why nothing is recorded, "" when all is well.

    ``longest_waits`` [s] are those of the last 10 to 20 minutes, by what waited.
    """

    site: str
    version: str
    t_ns: int
    uptime: float
    machines: tuple[MachineStatus, ...] = ()
    recording: str = ""
    recording_bytes: int = 0
    recording_failure: str = ""
    recording_dropped: int = 0
    longest_waits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Command:
    """What a person asks of the service; arguments are JSON values. ``t_ns`` is when (0: not stated), ``nonce`` a random word."""

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    asked_by: str = ""
    t_ns: int = 0
    nonce: str = ""


@dataclass(frozen=True, slots=True)
class CommandReply:
    """The answer, a JSON value, or one sentence why there is none."""

    ok: bool
    result: Any = None
    error: str = ""
