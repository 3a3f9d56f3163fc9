"""One machine in the service: its blocks are checked, judged, passed on and summarised."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from afdsvc.api.clock import Clock
from afdsvc.api.evidence import Evidence
from afdsvc.api.intervals import Intervals
from afdsvc.api.signals import Block, residual_block
from afdsvc.diagnosis.pipeline import ExcitableStream, Outcome
from afdsvc.diagnosis.verdict import FaultVerdict, conclude, model_gap
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.service.sinks import Sink
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import Alarm, Finding, MachineStatus, Notice, Residual, RigDescription, RigEvent

STALE_SECONDS = 2.0
REPORT_SECONDS = 60.0  # messages that cannot be read are one line in so long
MOST_REPORTED = 16  # machines a rig may falsely speak of, each reported once
LEVELS = {
    "gap": "warning",
    "bad_block": "warning",
    "bad_samples": "error",
    "frozen_sensor": "error",
    "plugin_failed": "error",
}


@dataclass
class MachineMonitor:
    """Takes the messages of one machine in order, in one thread; other threads only read the status."""

    machine: str
    pipeline: ExcitableStream
    sink: Sink
    clock: Clock
    findings: deque[Finding] = field(default_factory=lambda: deque(maxlen=400))

    def __post_init__(self) -> None:
        self.session = ""
        self.blocks = self.lost_samples = self.late = 0
        self.seconds_seen = 0.0
        self.head_room = 1.0
        self.present = False
        self.trouble = self.doubt = ""
        self._last = float("-inf")
        self._twins: set[str] = set()
        self._taken = "", Intervals()
        self._foreign: set[str] = set()
        self._reported = dict[str, float]()
        self._fresh: list[Finding] = []
        self._decisions, self._concluded = 0, (-1, FaultVerdict())
        self.residuals: deque[tuple[float, int, bool, Array]] | None = None  # end [s], samples, burst, sum of squares (p, p); kept for the console

    def take_block(self, payload: bytes) -> Outcome | None:
        """Judge a block and pass everything on; what cannot be decoded is named and dropped."""
        try:
            block = codec.decode_block(payload)
        except BadInput as error:
            self._ignore("block", error)
            return None
        if self._is_foreign("block", block.machine) or self._is_twin(block.session) or self._is_repeated(block):
            return None
        self.session = block.session
        self.blocks += 1
        self.late += block.late
        self.seconds_seen = (block.k0 + len(block)) * block.dt
        self.sink.take(Message(block, payload))
        outcome = self.pipeline.step(block)
        self.lost_samples += outcome.lost_samples
        for finding in outcome.findings:
            self.trouble = finding.message if LEVELS.get(finding.kind) == "error" else self.trouble
            self.say(LEVELS.get(finding.kind, "info"), finding.message, block.t0_ns)
        if outcome.residual is not None:
            self.sink.take(Message(Residual(residual_block(block, outcome.residual))))
            if self.residuals is not None:
                self.residuals.append((self.seconds_seen, len(block), bool(block.burst), outcome.residual.T @ outcome.residual))
            self.trouble = ""
        for e in outcome.evidence:
            stamp = block.t0_ns + round((e.k - block.k0) * block.dt * 1e9)
            self.findings.append(Finding(e, block.session, stamp))
            self._decisions += 1
            self._fresh.append(self.findings[-1])
            self.sink.take(Message(self._fresh[-1]))
        self._last = self.clock.monotonic()  # only now is the machine watched: the first block may take seconds
        return outcome

    @property
    def evidence(self) -> list[Evidence]:
        """The decisions that are kept, oldest first."""
        return [f.evidence for f in list(self.findings)]

    def fresh_findings(self) -> list[Finding]:
        """Return the decisions since the last call."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def decisions_on(self, burst: str) -> list[Evidence]:
        """Return the kept decisions on one burst."""
        return [e for e in self.evidence if e.burst == burst]

    def take_event(self, payload: bytes) -> RigEvent | None:
        """Pass an event of the rig on; None when it cannot be decoded."""
        try:
            event = codec.decode(RigEvent, payload)
        except BadInput as error:
            self._ignore("event", error)
            return None
        if self._is_foreign("event", event.machine):
            return None
        self.sink.take(Message(event, payload))
        return event

    def take_description(self, payload: bytes) -> None:
        """Note what the rig says of itself: its head-room, for the status."""
        try:
            description = codec.decode(RigDescription, payload)
        except BadInput as error:
            return self._ignore("description", error)
        if not self._is_foreign("description", description.machine):
            self.head_room = description.head_room

    def appeared(self, session: str) -> None:
        """Note that a rig agent announced itself; a second one at the same time is named and not listened to."""
        if self.present and self.session and session != self.session:
            self._twins.add(session)
            self.say("error", f"a second rig agent (session {session}) claims to be '{self.machine}'; its messages are ignored")
            return
        if session != self.session:
            self.seconds_seen = 0.0  # a new session counts its samples anew
        self.present, self.session = True, session
        self.say("info", f"rig agent of '{self.machine}' is connected")

    def gone(self, session: str) -> None:
        """Note that a rig agent vanished."""
        self._twins.discard(session)
        if session == self.session:
            self.present = False
            self.say("warning", f"rig agent of '{self.machine}' is disconnected")

    def doubt_model(self, kept: Sequence[Path] = ()) -> None:
        """Say once, until it is over, that the model seems to miss something: a notice, not an alarm.

        ``kept`` are the files of the machine's samples, which the suggested command names.
        """
        doubt = model_gap(self.evidence, kept=[str(path) for path in kept])
        if doubt and not self.doubt:
            self.say("warning", doubt)
        self.doubt = doubt

    def verdict(self) -> FaultVerdict:
        """Return what the kept decisions amount to, concluded anew when there are new ones."""
        previous, verdict = self._concluded
        if previous != self._decisions:
            previous = self._decisions
            verdict = conclude(self.evidence)
            self._concluded = previous, verdict
        return verdict

    def status(self, burst: str, next_burst: float, alarms: tuple[Alarm, ...]) -> MachineStatus:
        """Return how the machine is seen now."""
        age = self.clock.monotonic() - self._last
        state, reason = "running", self.trouble
        if not self.present:
            state, reason = "absent", "no rig agent is connected"
        elif age > STALE_SECONDS:
            state, reason = "stale", f"no block for {age:.1f} s" if self.blocks else "no block yet"
        verdict = self.verdict()
        return MachineStatus(
            self.machine,
            state,
            self.session,
            reason or self.doubt or verdict.reason,
            self.blocks,
            self.lost_samples,
            self.late,
            self.head_room,
            max(age, 0.0) if self.blocks else 0.0,
            burst,
            next_burst,
            verdict.trustworthy,
            alarms,
        )

    def say(self, level: str, sentence: str, t_ns: int | None = None) -> None:
        """Pass a sentence on."""
        self.sink.take(Message(Notice(self.machine, level, sentence, self.clock.now_ns() if t_ns is None else t_ns)))

    def _ignore(self, kind: str, error: BadInput) -> None:
        """Report a message that cannot be read, seldom: whoever sends rubbish must not fill log and recording."""
        now = self.clock.monotonic()
        if now - self._reported.get(kind, float("-inf")) >= REPORT_SECONDS:
            self._reported[kind] = now
            self.say("warning", f"{kind} ignored, and others like it for {REPORT_SECONDS:.0f} s: it could not be read: {error}")

    def _is_foreign(self, kind: str, machine: str) -> bool:
        """Whether a message under this machine's key speaks of another machine; each one is reported once and ignored.

        Access rules bind a rig to its key, so only the key says who sent a message.
        """
        if machine != self.machine and machine not in self._foreign and len(self._foreign) < MOST_REPORTED:
            self._foreign.add(machine)
            self.say("error", f"the rig agent of '{self.machine}' sent a {kind} of machine '{machine[:64]}'; such messages are ignored")
        return machine != self.machine

    def _is_repeated(self, block: Block) -> bool:
        """Whether a block has been taken already: a new network session brings again what publishers keep."""
        session, taken = self._taken if self._taken[0] == block.session else (block.session, Intervals())
        repeated = taken.covers(block.k0, block.k0 + len(block))
        taken.add(block.k0, block.k0 + len(block))
        self._taken = session, taken
        return repeated

    def _is_twin(self, session: str) -> bool:
        return session in self._twins
