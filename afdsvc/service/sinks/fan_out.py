"""Distribution of messages and findings to recorder, review and publisher; none may delay detection."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

from afdsvc.api.signals import Block
from afdsvc.lti.statespace import Array
from afdsvc.wire.messages import AlarmChange, BurstRequest, Finding, RetuneRequest, RigEvent

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

    def request(self, request: BurstRequest | RetuneRequest) -> None:
        """Take a burst or a Q that is about to be asked for."""
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
    """A sink behind a bounded queue and a thread of its own: it never blocks its caller, and drops are counted.

    With ``pause`` the thread lets messages gather for so many seconds: a hundred threads that wake for every block hold
    detection up by waking. A failure (a full disk or a full queue, say) is reported once by ``failed(sentence)``; the sink is tried again with
    every later message.
    """

    def __init__(self, sink: Sink, name: str, failed: Callable[[str], None], size: int = 4000, pause: float = 0.0) -> None:
        self._sink, self._failed, self._pause = sink, failed, pause
        self._queue: queue.SimpleQueue[tuple[str, tuple[object, ...]]] = queue.SimpleQueue()  # a third of the cost of Queue
        self._size = size
        self._overflowed = self._lost = 0
        self._full, self._left = False, threading.Event()
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that never reached the sink, or that it could not take."""
        return self._overflowed + int(getattr(self._sink, "dropped", self._lost))

    @property
    def waiting(self) -> int:
        """Messages in the queue."""
        return self._queue.qsize()

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

    def request(self, request: BurstRequest | RetuneRequest) -> None:
        """Queue a request."""
        self._put("request", request)

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Queue a sentence."""
        self._put("notice", machine, level, sentence, t_ns)

    def alarm(self, change: AlarmChange) -> None:
        """Queue what happened to an alarm."""
        self._put("alarm", change)

    def tick(self) -> None:
        """Nothing to do: the thread ticks the sink itself."""

    def leave(self) -> None:
        """Take nothing more; what is queued is still worked off."""
        self._left.set()

    def close(self, seconds: float = 4.0) -> None:
        """Work off the queue, finish the sink, and join the thread; what is not done in time is lost and counted."""
        self.leave()
        self._thread.join(seconds)
        if self._thread.is_alive():
            self._overflowed += self._queue.qsize()
            log.error("%s: %d messages are lost, the sink does not respond", self._thread.name, self._queue.qsize())

    def _put(self, what: str, *arguments: object) -> None:
        waiting = self._queue.qsize()
        if self._left.is_set() or waiting >= self._size:
            self._overflowed += 1
            if not self._full:
                self._full = True
                self._failed(f"{waiting} messages wait; further ones are dropped until the queue has room")
            return
        self._queue.put((what, arguments))
        self._full = self._full and waiting >= self._size // 2  # reported once, not at every gap

    def _work(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=0.05 if self._left.is_set() else 0.25)
            except queue.Empty:
                self._guarded("tick", ())
                if self._left.is_set():
                    return self._guarded("close", ())
                continue
            if self._pause and self._queue.empty():
                self._left.wait(self._pause)
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
            self._lost += what not in ("tick", "close")


class FanOut:
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

    def request(self, request: BurstRequest | RetuneRequest) -> None:
        """Pass a request on."""
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
