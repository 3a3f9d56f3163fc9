"""Where what a machine said and what was found about it goes: recorder, review, publisher; none may hold up detection."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

from afdsvc.api.signals import Block
from afdsvc.lti.statespace import Array
from afdsvc.wire.messages import AlarmChange, BurstRequest, Finding, RigEvent

log = logging.getLogger(__name__)


class Sink(Protocol):
    """Receives everything about one machine, in order. ``payload`` is the very message as it came over the wire."""

    def block(self, block: Block, payload: bytes) -> None:
        """Take a block of samples."""
        ...

    def residual(self, block: Block, residual: Array) -> None:
        """Take the whitened residual of a block, shape ``(n, p)``."""
        ...

    def finding(self, finding: Finding) -> None:
        """Take a decision of a detector."""
        ...

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Take an event of the rig."""
        ...

    def request(self, request: BurstRequest) -> None:
        """Take a burst that is about to be asked for."""
        ...

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Take a sentence of the service about a machine; level is info, warning or error."""
        ...

    def alarm(self, change: AlarmChange) -> None:
        """Take what happened to an alarm."""
        ...

    def tick(self) -> None:
        """Do what must be done at least twice a second, such as flushing."""
        ...

    def close(self) -> None:
        """Finish."""
        ...


class ThreadedSink:
    """A sink behind a bounded queue and a thread of its own: slow or failing, it holds nobody up, and drops are counted.

    A failure (a full disk, say) is told once by ``failed(sentence)``; the sink is tried again with every later message.
    """

    def __init__(self, sink: Sink, name: str, failed: Callable[[str], None], size: int = 4000) -> None:
        self._sink, self._failed = sink, failed
        self._queue: queue.Queue[tuple[str, tuple[object, ...]] | None] = queue.Queue(size)
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def block(self, block: Block, payload: bytes) -> None:
        """Queue a block."""
        self._put("block", block, payload)

    def residual(self, block: Block, residual: Array) -> None:
        """Queue a residual."""
        self._put("residual", block, residual)

    def finding(self, finding: Finding) -> None:
        """Queue a decision."""
        self._put("finding", finding)

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Queue an event."""
        self._put("event", event, payload)

    def request(self, request: BurstRequest) -> None:
        """Queue a burst request."""
        self._put("request", request)

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Queue a sentence."""
        self._put("notice", machine, level, sentence, t_ns)

    def alarm(self, change: AlarmChange) -> None:
        """Queue what happened to an alarm."""
        self._put("alarm", change)

    def tick(self) -> None:
        """Nothing to do: the thread ticks the sink itself."""

    def close(self) -> None:
        """Work off the queue, finish the sink, and join the thread (at most 10 s)."""
        try:
            self._queue.put(None, timeout=5)
        except queue.Full:
            log.warning("%s: the queue is full; what is in it is lost", self._thread.name)
        self._thread.join(10)

    def _put(self, what: str, *arguments: object) -> None:
        try:
            self._queue.put_nowait((what, arguments))
        except queue.Full:
            self.dropped += 1

    def _work(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=0.25)
            except queue.Empty:
                self._guarded("tick", ())
                continue
            if item is None:
                self._guarded("tick", ())
                self._guarded("close", ())
                return
            self._guarded(*item)
            self._guarded("tick", ())

    def _guarded(self, what: str, arguments: tuple[object, ...]) -> None:
        try:
            getattr(self._sink, what)(*arguments)
            if what != "tick":
                self.failure = ""
        except Exception as error:
            if not self.failure:
                self.failure = f"{type(error).__name__}: {error}"
                self._failed(self.failure)
            self.dropped += what in ("block", "finding", "event")


class Fan:
    """Several sinks as one."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = list(sinks)

    def block(self, block: Block, payload: bytes) -> None:
        """Pass a block on."""
        for sink in self.sinks:
            sink.block(block, payload)

    def residual(self, block: Block, residual: Array) -> None:
        """Pass a residual on."""
        for sink in self.sinks:
            sink.residual(block, residual)

    def finding(self, finding: Finding) -> None:
        """Pass a decision on."""
        for sink in self.sinks:
            sink.finding(finding)

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Pass an event on."""
        for sink in self.sinks:
            sink.event(event, payload)

    def request(self, request: BurstRequest) -> None:
        """Pass a burst request on."""
        for sink in self.sinks:
            sink.request(request)

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Pass a sentence on."""
        for sink in self.sinks:
            sink.notice(machine, level, sentence, t_ns)

    def alarm(self, change: AlarmChange) -> None:
        """Pass on what happened to an alarm."""
        for sink in self.sinks:
            sink.alarm(change)

    def tick(self) -> None:
        """Pass the tick on."""
        for sink in self.sinks:
            sink.tick()

    def close(self) -> None:
        """Close all."""
        for sink in self.sinks:
            sink.close()
