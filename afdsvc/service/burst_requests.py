"""Burst requests of one machine: sent to the rig when the scheduler decides, with the lease renewed while one is played."""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.clock import Clock
from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Channel
from afdsvc.diagnosis.pipeline import ExcitableStream
from afdsvc.diagnosis.verdict import open_question
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.service.scheduler import BurstOrder, Scheduler
from afdsvc.service.sinks import Sink
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, Command, EventKind, Lease, Notice, RigEvent

log = logging.getLogger(__name__)
LEASE_SECONDS = 2.0
LONGEST_WAIT = 5.0  # seconds ahead of its first sample a burst is asked for at most
ANSWER_SECONDS = 20.0  # a rig simulates a long burst before it accepts it
SHOWN = 2000  # samples of a planned burst that are shown
LEAD_SECONDS = 0.4  # a planned burst starts at its sample, however long the request was on its way
ENDS = (EventKind.BURST_ENDED, EventKind.BURST_ABORTED, EventKind.BURST_REFUSED, EventKind.RIG_STOPPED)


@dataclass
class BurstRequests:
    """Plays bursts on one machine. ``design(order)`` returns the burst for an order; its name is made unique here."""

    machine: str
    design: Callable[[BurstOrder], Burst]
    scheduler: Scheduler
    pipeline: ExcitableStream
    sink: Sink
    keys: Keys
    transport: Transport
    clock: Clock
    channels: Sequence[Channel] = ()  # with the units of what is shown

    def __post_init__(self) -> None:
        self._count = itertools.count(1)
        self._lock = threading.Lock()
        self._deadline = self._over = 0.0  # when a burst has ended: on the clock of the service, and in the machine's own time
        self._asking: threading.Thread | None = None
        self._played_by = ""  # the rig session the burst was asked of
        self._run = f"{self.clock.now_ns() // 10**9 % 16**6:06x}"  # names stay apart when the service restarts beside a rig
        self.session = ""
        self.seconds = 0.0
        self.playing = ""

    def present(self, session: str, seconds: float) -> None:
        """Note which rig session is there ("" when none) and its own time; a new one starts the period of bursts anew."""
        self.seconds = seconds
        if session and session != self.session:
            self.scheduler.machine_appeared(seconds)
        if self.playing and session and session != self._played_by:
            self._say("warning", f"burst '{self.playing}' ended: the rig agent was restarted")
            self._end()
        self.session = session

    def tick(self) -> None:
        """Start what is due, give up on what never ended; never waits for the rig."""
        if self.playing:
            self._give_up(self.clock.monotonic())
        if self.playing or (self._asking and self._asking.is_alive()):
            return
        ready = bool(self.session) and self._wait() <= LONGEST_WAIT
        order = self.scheduler.due(self.seconds, datetime.now()) if ready else None
        if order is not None:
            self._asking = threading.Thread(target=self._try, args=(order,), name=f"burst of {self.machine}", daemon=True)
            self._asking.start()

    def _try(self, order: BurstOrder) -> None:
        try:
            self.play(order)
        except AfdsvcError as refusal:
            self._say("warning", f"burst not played: {refusal}")
        except Exception as error:
            log.exception("machine '%s': a burst request failed", self.machine)
            self._say("error", f"burst not played: {type(error).__name__}: {error}")

    def ask(self, order: BurstOrder) -> str:
        """Play a burst a person asked for, at once; returns its name, raises `Refused` with the reason."""
        if not self.session:
            raise Refused(f"machine '{self.machine}' is not connected")
        self.scheduler.request(order, self.seconds, datetime.now())
        due = self.scheduler.due(self.seconds, datetime.now())
        if due is None:
            raise Refused("the machine is not ready for a burst")
        return self.play(due)

    def plan(self, order: BurstOrder) -> dict[str, Any]:
        """Return what a burst would play and what the nominal loop would answer, as JSON values; raises `Refused` where there is none yet.

        A burst for identification is drawn anew when it is played, within the same limits.
        """
        burst, problem = self.design(order), self.pipeline.problem
        alpha, G = burst.play(self.pipeline.dt), problem.plant
        p, m = G.outputs, G.inputs
        seen = StateSpace(G.A, G.B, np.vstack([G.C, np.zeros((m, G.order)), G.C]), np.vstack([G.D, np.eye(m), G.D]), G.dt)
        answer = simulate(star(seen, problem.interconnection, p, m), alpha)[0]
        limits, unit = problem.limits, {c.name: c.unit for c in self.channels}
        sides = [(name, "excitation", alpha[:, j], limits and limits.alpha[j]) for j, name in enumerate(problem.excitation_names)]
        sides += [(name, "output", answer[:, i], limits and limits.output[i]) for i, name in enumerate(problem.output_names)]
        sides += [(name, "input", answer[:, p + j], limits and limits.input[j]) for j, name in enumerate(problem.input_names)]
        role = {"output": "y", "input": "u", "excitation": "alpha" if problem.through == "alpha" else "ref"}
        hertz = [{"input": problem.excitation_names[line.input], "hertz": line.omega / (2 * np.pi), "amplitude": line.amplitude} for line in burst.lines]
        part = slice(None, None, max(1, len(alpha) // SHOWN))
        return {
            "machine": self.machine, "purpose": order.purpose, "seconds": burst.samples * self.pipeline.dt, "lines": hertz, "through": problem.through,
            "peaks": [
                {"name": name, "side": side, "peak": float(np.abs(x).max()), "limit": limit and float(limit), "unit": unit.get(f"{role[side]}_{name}", "")}
                for name, side, x, limit in sides
            ],
            "alpha": {name: alpha[part, j].tolist() for j, name in enumerate(problem.excitation_names)},
        }  # fmt: skip

    def play(self, order: BurstOrder) -> str:
        """Ask the rig for the burst; returns its name, raises `Refused` with the rig's reason."""
        if not self._lock.acquire(blocking=False):
            raise Refused("a burst is being prepared; only one burst is played at a time")
        try:
            if self.playing:
                raise Refused(f"burst '{self.playing}' is playing; only one burst is played at a time")
            made = self.design(order)
            burst = replace(made, name=self._name(), notes={**made.notes, "reason": order.reason})
            start = self._first_sample(order)
            newest = round(self.seconds / self.pipeline.dt)
            request = BurstRequest(
                self.machine, burst, LEASE_SECONDS, order.reason, self.clock.now_ns(), start, self.session, newest
            )
            message = Message(request)
            self.pipeline.announce(burst)
            self.sink.take(message)
            self._begin(burst, start)
            try:
                answer = self.transport.ask(self.keys.burst(self.machine), message.payload, ANSWER_SECONDS)
                reply = codec.decode(BurstReply, answer)
            except BaseException:
                self._withdraw(burst.name)
                raise
            if not reply.accepted:
                self._end()
                raise Refused(reply.reason)
            self._expect_end(self._seconds(burst, start))
            return burst.name
        finally:
            self._lock.release()

    def stop(self, reason: str, asked_by: str) -> None:
        """End whatever plays, smoothly; raises `Refused` with the rig's reason when nothing does."""
        stop = BurstStop(self.machine, reason or "no reason given", asked_by or "unknown")
        answer = self.transport.ask(self.keys.stop(self.machine), codec.encode(stop))
        reply = codec.decode(BurstReply, answer)
        if not reply.accepted:
            raise Refused(f"nothing is stopped: {reply.reason}")

    def inject(self, fault: str, severity: float, asked_by: str) -> None:
        """Put a fault into a simulated machine; raises `Refused` with the rig's reason where that cannot be."""
        command = Command("inject", {"fault": fault, "severity": severity}, asked_by, self.clock.now_ns())
        reply = codec.decode(BurstReply, self.transport.ask(self.keys.inject(self.machine), codec.encode(command)))
        if not reply.accepted:
            raise Refused(reply.reason)

    def heard(self, event: RigEvent) -> None:
        """Take an event of the rig into account."""
        if not self.playing or event.session != self._played_by or event.kind not in ENDS:
            return
        if event.burst == self.playing or event.kind is EventKind.RIG_STOPPED:
            self._end()

    def consider(self, burst: str, decisions: Sequence[Evidence]) -> None:
        """Plan a second burst when the decisions on a diagnosis burst leave open which fault it is; drop it when they do not."""
        known = self.pipeline.bursts.get(burst)
        if known is None or known.purpose != "diagnose":
            return
        question = open_question(decisions)
        if question:
            self.scheduler.follow_up(question)
        else:
            self.scheduler.settle(burst)

    def _name(self) -> str:
        return f"{self.session[:8]}-{self._run}-{next(self._count)}"

    def _wait(self) -> float:
        """Return the seconds until what comes back from a burst can be judged."""
        ready = self.pipeline.ready_at
        return float("inf") if ready is None else max(ready * self.pipeline.dt - self.seconds, 0.0)

    def _first_sample(self, order: BurstOrder) -> int:
        """Return the sample a burst starts at (0: at once): not before what comes back can be judged."""
        ready, wait = self.pipeline.ready_at, self._wait()
        if ready is None:
            raise Refused(f"machine '{self.machine}' has sent no usable samples yet; ask again once it runs")
        if wait > LONGEST_WAIT:
            raise Refused(f"machine '{self.machine}' has not been watched long enough to judge a burst; ask again in {wait:.0f} s")
        planned = 0 if order.at is None else round((order.at + LEAD_SECONDS) / self.pipeline.dt)
        return max(planned, ready if wait else 0)

    def _begin(self, burst: Burst, start: int) -> None:
        self._played_by = self.session
        self._expect_end(ANSWER_SECONDS + self._seconds(burst, start))
        self.playing = burst.name
        self.scheduler.started()

    def _expect_end(self, seconds: float) -> None:
        self._deadline, self._over = self.clock.monotonic() + seconds, self.seconds + seconds

    def _seconds(self, burst: Burst, start: int) -> float:
        """Return after how long a burst that is accepted now must have ended."""
        wait = max(start * self.pipeline.dt - self.seconds, 0.0)
        return wait + burst.samples * self.pipeline.dt + LEAD_SECONDS + 5.0

    def _withdraw(self, burst: str) -> None:
        """Take back a request that was not answered: the rig may accept it yet, and nobody would renew its lease."""
        self._end()
        stop = BurstStop(self.machine, "the request was not answered in time", "the service", burst)
        with contextlib.suppress(AfdsvcError):
            self.transport.ask(self.keys.stop(self.machine), codec.encode(stop))

    def _end(self) -> None:
        self.playing = ""
        self.scheduler.ended(self.seconds)

    def lease(self) -> Lease | None:
        """Return the lease of what plays, until its deadline; waits for nothing."""
        playing = self.playing
        return Lease(self.machine, playing, LEASE_SECONDS) if playing and self.clock.monotonic() <= self._deadline else None

    def _give_up(self, now: float) -> None:
        """End what has not ended in time; while the machine is there its own time counts: what it said may wait to be judged."""
        if now <= self._deadline or (self.session and self.seconds <= self._over):
            return
        if self.session:
            self._say("error", f"burst '{self.playing}' never ended; the rig did not say why")
        else:
            self._say("warning", f"burst '{self.playing}' is given up: the rig agent is not connected")
        self._end()

    def _say(self, level: str, sentence: str) -> None:
        self.sink.take(Message(Notice(self.machine, level, sentence, self.clock.now_ns())))
