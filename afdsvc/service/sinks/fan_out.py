"""Distribution of messages and findings to recorder, review and publisher; none may delay detection."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

from afdsvc.wire.codec import Message

log = logging.getLogger(__name__)


class Sink(Protocol):
    """Receives everything about one machine, in order: blocks and residuals, decisions, events, requests, notices, changes of alarms."""

    def take(self, message: Message) -> None:
        """Take a message; a sink passes by those it has no use for."""
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
        self._queue: queue.SimpleQueue[Message] = queue.SimpleQueue()  # a third of the cost of Queue
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

    def take(self, message: Message) -> None:
        """Queue a message."""
        waiting = self._queue.qsize()
        if self._left.is_set() or waiting >= self._size:
            self._overflowed += 1
            if not self._full:
                self._full = True
                self._failed(f"{waiting} messages wait; further ones are dropped until the queue has room")
            return
        self._queue.put(message)
        self._full = self._full and waiting >= self._size // 2  # reported once, not at every gap

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

    def _work(self) -> None:
        while True:
            try:
                message = self._queue.get(timeout=0.05 if self._left.is_set() else 0.25)
            except queue.Empty:
                self._guarded("tick")
                if self._left.is_set():
                    return self._guarded("close")
                continue
            if self._pause and self._queue.empty():
                self._left.wait(self._pause)
            self._guarded("take", message)
            self._guarded("tick")

    def _guarded(self, what: str, *arguments: Message) -> None:
        try:
            getattr(self._sink, what)(*arguments)
            if what != "tick":
                self.failure = ""
        except Exception as error:
            if not self.failure:
                self.failure = f"{type(error).__name__}: {error}"
                self._failed(self.failure)
            self._lost += what == "take"


class FanOut:
    """Several sinks as one."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = list(sinks)

    def take(self, message: Message) -> None:
        """Pass a message on."""
        for sink in self.sinks:
            sink.take(message)

    def tick(self) -> None:
        """Pass the tick on."""
        for sink in self.sinks:
            sink.tick()

    def close(self) -> None:
        """Close all."""
        for sink in self.sinks:
            sink.close()
