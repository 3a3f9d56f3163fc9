"""The running service: messages from zenoh go through one queue to one worker; a ticker plays bursts and publishes the state.

Leases are renewed by a process that does nothing else (`afdsvc.transport.lease_keeper`) and hears from a thread that does nothing else: neither a design, a
judgement, a disk, a viewer nor a computer that is overloaded holds them up.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from afdsvc.api.clock import Clock
from afdsvc.diagnosis.alarm_book import UNNAMED, AlarmBook, Policy
from afdsvc.diagnosis.pipeline import Outcome
from afdsvc.diagnosis.verdict import FaultVerdict, conclude
from afdsvc.errors import BadInput, Refused
from afdsvc.service.audit_log import AuditLog
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.service.clock import Watchdog
from afdsvc.service.housekeeping import machine_of_file
from afdsvc.service.machine import MachineMonitor
from afdsvc.service.notifications import History, Judged, NotificationQueue
from afdsvc.service.recorder_sink import Receipts
from afdsvc.service.retuning import Retuning
from afdsvc.service.sinks import ThreadedSink, sentence_of
from afdsvc.service.standby import handed_over
from afdsvc.transport.lease_keeper import PERIOD_SECONDS, LeaseKeeper
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys, machine_of, session_of
from afdsvc.wire.messages import AlarmChange, AlarmKind, EventKind, Finding, MachineStatus, ServiceStatus

log = logging.getLogger(__name__)
TROUBLE = ("bad_samples", "frozen_sensor", "plugin_failed")  # findings about the watching that call for a person
PASSING = ("bad_samples", "frozen_sensor")  # those that end by themselves
TICK_SECONDS = 0.05
STATUS_SECONDS = 1.0
STOPPING_SECONDS = 2.5  # a service has 5 s to stop, files included
FULL_SECONDS = 2.0  # a message waits so long for room in the queue; zenoh holds the link for 10 s
BEHIND_SECONDS = 2.0  # a judgement that is late by more is in the status
HUNG_SECONDS = 20.0  # a thread that has not come round for so long is stuck


@dataclass
class Hub:
    """Joins monitors (one per machine), burst requests and retunings (one per machine that can be driven) with the transport.

    ``recording()`` returns file, bytes, failure and drops of the recorder for the status.
    """

    keys: Keys
    version: str
    watches: Mapping[str, MachineMonitor]
    burst_requests: Mapping[str, BurstRequests]
    transport: Transport
    clock: Clock
    recording: Callable[[], tuple[str, int, str, int]]
    files: Callable[[], list[Path]] = list
    queue_size: int = 8_000  # blocks of 20 kB: at most 160 MB wait
    policy: Policy = field(default_factory=Policy)
    history: History | None = None
    outboxes: Sequence[NotificationQueue] = ()
    audit: AuditLog | None = None
    late: Mapping[str, tuple[Receipts, ThreadedSink]] = field(default_factory=dict)
    retunings: Mapping[str, Retuning] = field(default_factory=dict)
    keeper: LeaseKeeper | None = None

    def __post_init__(self) -> None:
        self._queue: queue.Queue[tuple[str, str, Any, float] | None] = queue.Queue(self.queue_size)
        self._stop, self._given_up, self._judging = threading.Event(), threading.Event(), float("inf")
        self._began = self.clock.monotonic()
        self._next_status = self._worked = self._ticked = self._renewed = self._began
        self.watchdog = Watchdog(self.clock)
        self._strangers: set[str] = set()
        self.alarms = AlarmBook(self.policy, self._pass_on)
        self.changes, self._changed = 0, threading.Condition()  # of alarms and decisions, which pages wait for
        self.dropped = 0
        self.findings: list[Finding] = []
        self.refusals: list[str] = []

    def start(self) -> None:
        """Take up the alarms of the last run, then listen and watch for rigs."""
        self._remember()
        t, keys = self.transport, self.keys
        self._threads = [
            threading.Thread(target=self._guard, args=(self._work,), name="afdsvc-worker", daemon=True),
            threading.Thread(target=self._guard, args=(self._tick_for_ever,), name="afdsvc-ticker", daemon=True),
            threading.Thread(target=self._guard, args=(self._renew_for_ever,), name="afdsvc-leases", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        t.subscribe(keys.blocks(), lambda key, payload: self._put("block", key, payload))
        t.subscribe(keys.events(), lambda key, payload: self._put("event", key, payload))
        t.subscribe(keys.descriptions(), lambda key, payload: self._put("description", key, payload))
        t.watch(keys.all_alive(), lambda key, alive: self._put("alive", key, alive))
        for machine in self.late:
            t.serve(keys.stored(machine), partial(self._take_stored, machine))
        if self.history:
            t.serve(keys.handover(), partial(handed_over, self.history))
        t.announce(keys.service_alive())

    def _take_stored(self, machine: str, payload: bytes) -> bytes:
        """Record a block that the rig kept during an outage; it is not judged.

        Refused while judgement is behind: what waits for it is recorded then, and would be delivered a second time.
        """
        if self._stop.is_set():
            raise Refused("the service is about to end")
        if (behind := self.behind()) > BEHIND_SECONDS:
            raise Refused(f"judgement is {behind:.0f} s behind; what a rig keeps is taken when it has caught up")
        block, (receipts, sink) = codec.decode_block(payload), self.late[machine]
        if block.machine != machine:
            raise Refused(f"a block of machine '{block.machine[:64]}' delivered by the rig agent of '{machine}'")
        if receipts.covers(block.session, block.k0, block.k0 + len(block)):
            return b"known"
        sink.take(Message(block, payload))
        return b"taken"

    def _remember(self) -> None:
        if self.history is None:
            return
        try:
            self.alarms.restore(self.history.last(), self.clock.now_ns())
        except BadInput as error:
            log.error("the alarms of the last run cannot be read: %s", error)

    def drain(self, seconds: float = 10.0) -> None:
        """Wait until what has arrived is worked off."""
        deadline = time.monotonic() + seconds
        while (self._queue.unfinished_tasks or self._queue.qsize()) and time.monotonic() < deadline:
            time.sleep(0.02)

    def stop(self) -> None:
        """Stop listening, work off the queue as far as `STOPPING_SECONDS` go, join the threads; what remains is counted."""
        self._stop.set()
        deadline = time.monotonic() + STOPPING_SECONDS
        self._put_last()
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.05))
        if self._queue.qsize():
            self._given_up.set()
            self.dropped += self._queue.qsize()
            log.error("the worker does not keep up; %d messages are waiting", self._queue.qsize())

    def status(self) -> ServiceStatus:
        """Return how the service and its machines are."""
        file, size, failure, dropped = self.recording()
        machines = tuple(self._machine_status(m) for m in self.watches)
        return ServiceStatus(
            self.keys.site,
            self.version,
            self.clock.now_ns(),
            self.clock.monotonic() - self._began,
            machines,
            file,
            size,
            failure,
            dropped + self.dropped,
            self.watchdog.longest(),
        )

    def _machine_status(self, machine: str) -> MachineStatus:
        requests = self.burst_requests.get(machine)
        watch = self.watches[machine]
        next_burst = requests.scheduler.seconds_to_next(requests.seconds) if requests else 0.0
        tuning = self.retunings[machine].sentence if machine in self.retunings and watch.present else ""
        seen, behind = watch.status(requests.playing if requests else "", next_burst, self.alarms.of(machine)), self.behind()
        late = f"judgement is {behind:.0f} s behind, {self._queue.qsize()} messages wait" if behind > BEHIND_SECONDS else ""
        return replace(seen, tuning=tuning, reason="; ".join(filter(None, (late, seen.reason))))

    def _put(self, kind: str, key: str, what: Any) -> None:
        """Leave a message to the worker. When too many wait the sender does too: its rigs then keep what they say, for minutes."""
        try:
            self._queue.put((kind, key, what, self.clock.monotonic()), timeout=0.05 if self._stop.is_set() else FULL_SECONDS)
        except queue.Full:
            self.dropped += 1

    def _put_last(self) -> None:
        try:
            self._queue.put(None, timeout=0.5)
        except queue.Full:
            log.debug("the queue is full")

    def _guard(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception:
            log.exception("a service thread failed")

    def behind(self) -> float:
        """Return how long [s] the message that is being judged has waited so far; those behind it came later."""
        return max(self.clock.monotonic() - self._judging, 0.0)

    def healthy(self) -> bool:
        """Whether all threads have come round lately: what a watchdog is fed by."""
        oldest = min(self._worked, self._ticked, self._renewed)
        return self.clock.monotonic() - oldest < HUNG_SECONDS and all(t.is_alive() for t in self._threads)

    def _work(self) -> None:
        while not self._given_up.is_set():
            self._worked = self.clock.monotonic()
            try:
                item = self._queue.get(timeout=1.0)
            except queue.Empty:
                continue
            if item is None:
                return
            kind, key, what, self._judging = item
            try:
                self._handle(kind, key, what)
            except Exception:
                log.exception("a message on %s could not be handled", key)
            finally:
                self._queue.task_done()
                self.watchdog.note("judgement", self.behind())
                self._judging = float("inf")

    def _handle(self, kind: str, key: str, what: Any) -> None:
        machine = machine_of(key)
        watch = self.watches.get(machine)
        if watch is None:
            if machine not in self._strangers:
                self._strangers.add(machine)
                log.warning("machine '%s' is not in the site file; its messages are ignored", machine)
        elif kind == "block":
            self._block(watch, what)
        elif kind == "event":
            self._event(watch, what)
        elif kind == "description":
            watch.take_description(what)
        else:
            (watch.appeared if what else watch.gone)(session_of(key))
            self._note_presence(watch)

    def _block(self, watch: MachineMonitor, payload: bytes) -> None:
        outcome = watch.take_block(payload)
        requests = self._note_presence(watch)
        if outcome is None:
            return
        self._note_conditions(watch, outcome)
        fresh = watch.fresh_findings()
        for finding in fresh:
            sentence = sentence_of(finding)
            alarm = self.alarms.take(finding, sentence)
            if alarm is not None:
                watch.say("error", sentence)
                if requests:
                    requests.scheduler.after_event(alarm.id)
        if fresh:
            self._sum_up(watch, fresh[-1].t_ns)
            self._note_change()
        for burst in {f.evidence.burst for f in fresh if f.evidence.burst}:
            self._keep_judged(watch, burst, fresh[-1].t_ns)
            if requests:
                requests.consider(burst, watch.decisions_on(burst))

    def _keep_judged(self, watch: MachineMonitor, burst: str, t_ns: int) -> None:
        """Keep what the decisions on a burst amount to; of one that cannot be trusted nothing."""
        found = conclude(watch.decisions_on(burst))
        if found.trustworthy and self.history is not None:
            size = (found.severity.value, found.severity.sd) if found.severity else (None, None)
            for outbox in self.outboxes[:1]:
                outbox.put(Judged(watch.machine, burst, t_ns, found.fault or (UNNAMED if found.detected else ""), *size))

    def _note_conditions(self, watch: MachineMonitor, outcome: Outcome) -> None:
        """Raise an alarm for a failure of the monitoring itself; it ends with the next valid samples."""
        now = self.clock.now_ns()
        for finding in outcome.findings:
            if finding.kind in TROUBLE:
                self.alarms.condition(watch.machine, finding.kind, AlarmKind.SYSTEM, True, finding.message, now)
        if outcome.residual is not None:
            for kind in PASSING:
                self.alarms.condition(watch.machine, kind, AlarmKind.SYSTEM, False, "the samples are valid again", now)

    def _sum_up(self, watch: MachineMonitor, t_ns: int) -> None:
        """Group alarms under what the evidence as a whole names; say when the model rather than a part is to be doubted."""
        watch.doubt_model([path for path in self.files() if path.suffix == ".mcap" and machine_of_file(path) == watch.machine])
        why = watch.doubt or "the residual is explained by the model or a fault again"
        self.alarms.condition(watch.machine, "model_gap", AlarmKind.NOTICE, bool(watch.doubt), why, t_ns)
        if any(a.active for a in self.alarms.of(watch.machine)):
            self.alarms.group(watch.machine, watch.verdict().fault, t_ns)
        if watch.machine in self.retunings:
            self.retunings[watch.machine].propose(self.standing(watch.machine))

    def standing(self, machine: str) -> FaultVerdict:
        """Return the verdict on a machine while its alarm, of the fault that it names or of none, is active, else an empty one."""
        verdict = self.watches[machine].verdict()
        alarm = self.alarms.alarms.get(f"{machine}/{verdict.fault or UNNAMED}")
        return verdict if alarm and alarm.active else FaultVerdict()

    def _pass_on(self, change: AlarmChange) -> None:
        """Pass a change of an alarm to the sinks and the notifiers."""
        watch = self.watches.get(change.alarm.machine)
        if watch:
            watch.sink.take(Message(change))
        for outbox in self.outboxes:
            outbox.put(change)
        self._note_change()

    def _note_change(self) -> None:
        with self._changed:
            self.changes += 1
            self._changed.notify_all()

    def wait_for_change(self, known: int, seconds: float) -> None:
        """Return when ``changes`` is no longer ``known``, or after so many seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self.changes != known, seconds)

    def _note_presence(self, watch: MachineMonitor) -> BurstRequests | None:
        requests = self.burst_requests.get(watch.machine)
        if requests:
            requests.present(watch.session if watch.present and watch.blocks else "", watch.seconds_seen)
        return requests

    def _event(self, watch: MachineMonitor, payload: bytes) -> None:
        event = watch.take_event(payload)
        if event is None:
            return
        if event.kind in (EventKind.BURST_REFUSED, EventKind.BURST_ABORTED):
            self.refusals.append(event.cause)
            del self.refusals[:-100]
        requests = self.burst_requests.get(watch.machine)
        if requests:
            requests.heard(event)
        if watch.machine in self.retunings:
            self.retunings[watch.machine].heard(event)

    def _renew_for_ever(self) -> None:
        """Have the leases of all machines renewed."""
        self._renewed = self.clock.monotonic()
        while not self._stop.wait(PERIOD_SECONDS):
            waited, self._renewed = self.clock.monotonic() - self._renewed, self.clock.monotonic()
            held = [r.lease() for r in self.burst_requests.values()] + [r.lease() for r in self.retunings.values()]
            leases = [(self.keys.lease(lease.machine), codec.encode(lease)) for lease in held if lease]
            if self.keeper and self.keeper.renew(leases):
                waited, self.keeper.longest = self.keeper.longest, 0.0
            else:  # it does not answer (yet), so this thread renews them
                for key, lease in leases:
                    self.transport.publish(key, lease, keep=False)
            self.watchdog.note("leases", waited)

    def _tick_for_ever(self) -> None:
        self._ticked = self.clock.monotonic()
        while not self._stop.wait(TICK_SECONDS):
            now = self.clock.monotonic()
            self.watchdog.note("bursts", now - self._ticked)
            self.watchdog.note("judgement", self.behind())  # also of one that never ends
            self._ticked = now
            for requests in self.burst_requests.values():
                requests.tick()
            if self.clock.monotonic() >= self._next_status:
                self._next_status = self.clock.monotonic() + STATUS_SECONDS
                self.transport.publish(self.keys.status(), codec.encode(self.status()), keep=False)
                for machine, (receipts, _) in self.late.items():
                    self.transport.publish(self.keys.receipt(machine), codec.encode(receipts.receipt(machine)), keep=False)
                self.alarms.tick(self.clock.now_ns())
