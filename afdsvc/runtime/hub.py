"""The running service: what comes over zenoh goes through one queue to one worker; a ticker plays bursts, tells the state."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from afdsvc.api.clock import Clock
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.runtime.alarms import AlarmBook
from afdsvc.runtime.commands import answer
from afdsvc.runtime.desk import BurstDesk
from afdsvc.runtime.scheduler import Wanted
from afdsvc.runtime.transport import Transport
from afdsvc.runtime.watch import MachineWatch
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys, machine_of, session_of
from afdsvc.wire.messages import EventKind, Finding, MachineStatus, ServiceStatus

log = logging.getLogger(__name__)
TICK_SECONDS = 0.05
STATUS_SECONDS = 1.0


@dataclass
class Hub:
    """Joins watches (one per machine) and desks (one per machine that can be driven) with the transport.

    ``recording()`` returns file, bytes, failure and drops of the recorder for the status.
    """

    keys: Keys
    version: str
    watches: Mapping[str, MachineWatch]
    desks: Mapping[str, BurstDesk]
    transport: Transport
    clock: Clock
    recording: Callable[[], tuple[str, int, str, int]]
    files: Callable[[], list[Path]] = list
    queue_size: int = 40_000
    alarms: AlarmBook = field(default_factory=AlarmBook)

    def __post_init__(self) -> None:
        self._queue: queue.Queue[tuple[str, str, Any] | None] = queue.Queue(self.queue_size)
        self._stop = threading.Event()
        self._began = self.clock.monotonic()
        self._next_status = self._began
        self._strangers: set[str] = set()
        self.dropped = 0
        self.findings: list[Finding] = []
        self.refusals: list[str] = []

    def start(self) -> None:
        """Refuse a second service, then listen, watch for rigs, answer people."""
        t, keys = self.transport, self.keys
        self._threads = [
            threading.Thread(target=self._guard, args=(self._work,), name="afdsvc-worker", daemon=True),
            threading.Thread(target=self._guard, args=(self._tick_for_ever,), name="afdsvc-ticker", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        t.subscribe(keys.blocks(), lambda key, payload: self._put("block", key, payload))
        t.subscribe(keys.events(), lambda key, payload: self._put("event", key, payload))
        t.subscribe(keys.descriptions(), lambda key, payload: self._put("description", key, payload))
        t.watch(keys.all_alive(), lambda key, alive: self._put("alive", key, alive))
        t.serve(keys.command(), lambda payload: answer(self._handlers(), payload))
        t.announce(keys.service_alive())

    def drain(self, seconds: float = 10.0) -> None:
        """Wait until what has arrived is worked off."""
        deadline = time.monotonic() + seconds
        while (self._queue.unfinished_tasks or self._queue.qsize()) and time.monotonic() < deadline:
            time.sleep(0.02)

    def stop(self) -> None:
        """Stop listening, work off the queue, join the threads."""
        self._stop.set()
        self._put_last()
        for thread in self._threads:
            thread.join(10)

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
        )

    def _machine_status(self, machine: str) -> MachineStatus:
        desk = self.desks.get(machine)
        watch = self.watches[machine]
        next_burst = desk.scheduler.seconds_to_next(desk.seconds) if desk else 0.0
        return watch.status(desk.playing if desk else "", next_burst, self.alarms.of(machine))

    def _put(self, kind: str, key: str, what: Any) -> None:
        try:
            self._queue.put_nowait((kind, key, what))
        except queue.Full:
            self.dropped += 1

    def _put_last(self) -> None:
        try:
            self._queue.put(None, timeout=5)
        except queue.Full:
            log.error("the worker does not keep up; %d messages are left", self._queue.qsize())

    def _guard(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception:
            log.exception("a service thread failed")

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            kind, key, what = item
            try:
                self._handle(kind, key, what)
            except Exception:
                log.exception("a message on %s could not be handled", key)
            finally:
                self._queue.task_done()

    def _handle(self, kind: str, key: str, what: Any) -> None:
        machine = machine_of(key)
        watch = self.watches.get(machine)
        if watch is None:
            if machine not in self._strangers:
                self._strangers.add(machine)
                log.warning("machine '%s' is not in the site file; it is not listened to", machine)
        elif kind == "block":
            self._block(watch, what)
        elif kind == "event":
            self._event(watch, what)
        elif kind == "description":
            watch.take_description(what)
        else:
            (watch.appeared if what else watch.gone)(session_of(key))
            self._tell_desk(watch)

    def _block(self, watch: MachineWatch, payload: bytes) -> None:
        outcome = watch.take_block(payload)
        desk = self._tell_desk(watch)
        fresh = watch.fresh_findings() if outcome else []
        for finding in fresh:
            alarm = self.alarms.take(finding)
            watch.doubt_model()
            if alarm is not None:
                watch.say("error", sentence_of(finding))
                if desk:
                    desk.scheduler.after_event(alarm.id)
        if desk:
            for burst in {f.evidence.burst for f in fresh if f.evidence.burst}:
                desk.consider(burst, watch.decisions_on(burst))

    def _tell_desk(self, watch: MachineWatch) -> BurstDesk | None:
        desk = self.desks.get(watch.machine)
        if desk:
            desk.present(watch.session if watch.present and watch.blocks else "", watch.seconds_seen)
        return desk

    def _event(self, watch: MachineWatch, payload: bytes) -> None:
        event = watch.take_event(payload)
        if event is None:
            return
        if event.kind in (EventKind.BURST_REFUSED, EventKind.BURST_ABORTED):
            self.refusals.append(event.cause)
            del self.refusals[:-100]
        desk = self.desks.get(watch.machine)
        if desk:
            desk.heard(event)

    def _tick_for_ever(self) -> None:
        while not self._stop.wait(TICK_SECONDS):
            for desk in self.desks.values():
                desk.tick()
            if self.clock.monotonic() >= self._next_status:
                self._next_status = self.clock.monotonic() + STATUS_SECONDS
                self.transport.publish(self.keys.status(), codec.encode_status(self.status()))

    def _handlers(self) -> dict[str, Callable[[Mapping[str, Any], str], Any]]:
        return {
            "status": lambda a, who: self.status(),
            "alarms": lambda a, who: list(self.alarms.alarms.values()),
            "ack": lambda a, who: self.alarms.acknowledge(str(a.get("alarm", "")), who, str(a.get("comment", ""))),
            "burst": lambda a, who: {
                "burst": self._desk(a).ask(Wanted(f"asked by {who}", purpose=str(a.get("purpose") or "diagnose")))
            },
            "stop": lambda a, who: self._desk(a).stop(str(a.get("reason", "")), who),
            "pause": lambda a, who: self._pause(a, f"by {who}: {a.get('reason', '')}"),
            "resume": lambda a, who: self._pause(a, ""),
        }

    def _desk(self, arguments: Mapping[str, Any]) -> BurstDesk:
        machine = arguments.get("machine") or (next(iter(self.watches)) if len(self.watches) == 1 else "")
        if machine not in self.watches:
            raise BadInput(f"machine {machine!r} is unknown; this site has {', '.join(self.watches)}")
        if machine not in self.desks:
            raise AfdsvcError(f"machine '{machine}' can be watched, not excited")
        return self.desks[str(machine)]

    def _pause(self, arguments: Mapping[str, Any], why: str) -> dict[str, str]:
        desk = self._desk(arguments)
        desk.scheduler.paused = why
        return {"machine": desk.machine, "paused": why}


def sentence_of(finding: Finding) -> str:
    """Return a decision as one sentence for people."""
    e = finding.evidence
    how = f"{e.detector}: statistic {e.statistic:.3g} over threshold {e.threshold:.3g}"
    if e.fault and e.severity:
        return f"{e.machine}: {e.fault} {100 * e.severity.value:+.1f} % (+-{100 * e.severity.sd:.1f} %); {how}"
    likely = ", ".join(f"{name} {100 * w:.0f} %" for name, w in sorted(e.weights.items(), key=lambda i: -i[1])[:3])
    return f"{e.machine}: a fault; {how}" + (f"; between {likely}" if likely else "")
