"""Q beside the controller of one machine: designed and proved when a person accepts it, its lease renewed while it acts, and taken back."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, Tuning
from afdsvc.diagnosis.verdict import FaultVerdict
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import BurstReply, BurstStop, EventKind, Lease, Notice, RetuneRequest, RigEvent

LEASE_SECONDS = 5.0
ANSWER_SECONDS = 10.0
DEVIATIONS = 3.0  # of the severity's standard error, on both sides: the interval Q is proved for
OVER = (EventKind.RESTORED, EventKind.RETUNE_REFUSED, EventKind.RIG_STOPPED)

Design = Callable[[DetectionProblem, DiagnosedFault], tuple[Tuning, str, Mapping[str, Any]]]


@dataclass
class Retuning:
    """Retunes one machine, the one of ``bursts``.

    ``design(problem, found)`` returns Q as a rig runs it, what was proved in one sentence, and the design sheet; it raises `Refused`. ``ready`` is
    called with the problem of the loop with Q before Q acts.
    """

    bursts: BurstRequests
    design: Design
    ready: Callable[[DetectionProblem], object]

    def __post_init__(self) -> None:
        self._count, self._designing = itertools.count(1), threading.Lock()
        self._session = self._proposed = ""
        self._withdrawn: BurstStop | None = None
        self.acting = ""  # the name of the Q
        self.sentence = ""  # a Q is proposed, or acts

    @property
    def machine(self) -> str:
        """Id of the machine."""
        return self.bursts.machine

    def propose(self, verdict: FaultVerdict) -> None:
        """Say once, for each fault that is named with its severity, that a person may accept a Q for it; say no more where none is."""
        if self.acting:
            return
        if verdict.fault is None or verdict.severity is None:
            self.sentence = ""
            return
        found = _interval(verdict, self.bursts.pipeline.problem)
        self.sentence = f"proposed: 'afdsvc retune {self.machine}' designs Q for {_said(found)}"
        if verdict.fault != self._proposed:
            self._proposed = verdict.fault
            self.bursts.sink.take(Message(Notice(self.machine, "info", self.sentence, self.bursts.clock.now_ns())))

    def ask(self, verdict: FaultVerdict, who: str, stated: DiagnosedFault | None = None) -> dict[str, Any]:
        """Design, prove and start Q for what the verdict names, or what a person has ``stated`` instead; returns the design sheet, raises
        `Refused` with the reason."""
        if not self._designing.acquire(blocking=False):
            raise Refused("a Q is being designed for this machine; wait for its answer")
        self._withdrawn = None
        try:
            return self._asked(verdict, who, stated)
        finally:
            self._designing.release()

    def _asked(self, verdict: FaultVerdict, who: str, stated: DiagnosedFault | None) -> dict[str, Any]:
        of = self.bursts
        if not of.session:
            raise Refused(f"machine '{self.machine}' is not connected")
        if self.acting:
            raise Refused(f"{self.sentence}; restore the machine first")
        if stated is None and (verdict.fault is None or verdict.severity is None):
            raise Refused(f"no fault has been named with its severity{_left_open(verdict)}, so there is nothing to design Q for; '--fault' states one")
        problem = of.pipeline.problem
        found = stated or _interval(verdict, problem)
        tuning, proof, sheet = self.design(problem, found)
        self._refuse_withdrawn()
        name = f"{of.session[:8]}-q-{of.clock.now_ns() // 10**9 % 16**6:06x}-{next(self._count)}"
        self.ready(of.pipeline.announce_tuning(name, tuning.Q))
        newest = round(of.seconds / of.pipeline.dt)
        message = Message(RetuneRequest(self.machine, name, tuning, found, LEASE_SECONDS, who, of.clock.now_ns(), of.session, newest, proof))
        of.sink.take(message)
        self._begin(message)
        if self._withdrawn:  # while the rig was asked
            self._stopped(self._withdrawn)
            self._refuse_withdrawn()
        return {"machine": self.machine, "tuning": name, "fault": found.fault, "severity": [found.low, found.high], **sheet}

    def _begin(self, message: Message) -> None:
        of, request = self.bursts, message.value
        self._session = request.session
        self.acting, self.sentence = request.name, f"Q for {_said(request.found)} acts, accepted by {request.asked_by}"
        try:
            answer = of.transport.ask(of.keys.retune(self.machine), message.payload, ANSWER_SECONDS)
            reply = codec.decode(BurstReply, answer)
        except BaseException:
            self._end()  # if the rig has accepted it yet, its lease runs out
            raise
        if not reply.accepted:
            self._end()
            raise Refused(reply.reason)

    def restore(self, reason: str, who: str) -> None:
        """Go back to Q = 0, also where Q is still being designed; raises `Refused` with the rig's reason when there is none."""
        stop, designing = BurstStop(self.machine, reason or "no reason given", who or "unknown"), self._designing.locked()
        self._withdrawn = stop
        reply = self._stopped(stop)
        if not (reply.accepted or designing):
            raise Refused(f"nothing is restored: {reply.reason}")

    def _stopped(self, stop: BurstStop) -> BurstReply:
        of = self.bursts
        return codec.decode(BurstReply, of.transport.ask(of.keys.restore(self.machine), codec.encode(stop)))

    def _refuse_withdrawn(self) -> None:
        if self._withdrawn:
            raise Refused(f"withdrawn by {self._withdrawn.asked_by} while Q was designed: {self._withdrawn.reason}")

    def lease(self) -> Lease | None:
        """Return the lease of the Q that acts; waits for nothing."""
        acting = self.acting
        return Lease(self.machine, acting, LEASE_SECONDS) if acting else None

    def heard(self, event: RigEvent) -> None:
        """Take an event of the rig into account; another session than that of the Q knows none."""
        if self.acting and (event.session != self._session or event.kind is EventKind.RIG_STOPPED or (event.kind in OVER and event.burst == self.acting)):
            self._end()

    def _end(self) -> None:
        self.acting = self.sentence = self._proposed = ""


def _interval(verdict: FaultVerdict, problem: DetectionProblem) -> DiagnosedFault:
    """Return the fault with its severity, `DEVIATIONS` standard errors to both sides, within what the machine can have."""
    if verdict.fault is None or verdict.severity is None:
        raise AfdsvcError("the verdict names no fault with its severity")
    value, wide, (low, high) = verdict.severity.value, DEVIATIONS * verdict.severity.sd, problem.severity_range
    return DiagnosedFault(verdict.fault, max(value - wide, low), min(value + wide, high))


def _left_open(verdict: FaultVerdict) -> str:
    likely = sorted(((w, name) for name, w in verdict.weights.items() if w > 0.01), reverse=True)
    return f" (the newest decision: {', '.join(f'{name} {100 * w:.0f} %' for w, name in likely)})" if likely else ""


def _said(found: DiagnosedFault) -> str:
    return f"{found.fault} {100 * found.low:.1f} to {100 * found.high:.1f} %"
