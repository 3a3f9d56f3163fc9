"""Sinks: everything about a machine goes to the recorder, the review, viewers and the log; none may delay detection."""

from __future__ import annotations

import logging
import math
import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Protocol

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.transport.outgoing_queue import OutgoingQueue
from afdsvc.wire.codec import Message
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import AlarmChange, EventKind, Finding, Notice, Residual, RetuneRequest, RigEvent

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
            if not self._full and not self._left.is_set():
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


_payload = attrgetter("payload")  # encoded in the thread of the queue, unless another sink has


@dataclass
class Publisher:
    """Publishes residuals and decisions of one machine; blocks and events are on the wire already.

    Residuals go by ``stream``, where only the newest matter, decisions and alarms by ``post``; neither waits for a viewer.
    """

    keys: Keys
    post: OutgoingQueue
    stream: OutgoingQueue
    heard: Callable[[str], bool] = lambda key: True

    def take(self, message: Message) -> None:
        """Publish a residual when anybody looks at it, a decision, or what happened to an alarm."""
        match message.value:
            case Residual(block):
                if self.heard(self.keys.residual(block.machine)):
                    self.stream.send(self.keys.residual(block.machine), _payload, message)
            case Finding(evidence):
                self.post.send(self.keys.evidence(evidence.machine), _payload, message)
            case AlarmChange(alarm):
                self.post.send(self.keys.alarm(alarm.machine), _payload, message)

    def tick(self) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing: the posts are closed by whoever opened them."""


LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class LogSink:
    """A sink that writes lines; samples pass it by.

    A burst has one line when it starts and, of the decisions that find nothing, one for the first; that it ended has none.
    """

    def __init__(self, machine: str) -> None:
        self._machine = machine
        self._quiet = ""  # the burst on which nothing was found, already said
        self._said: deque[str] = deque(maxlen=32)  # sentences on decisions that have been written

    def take(self, message: Message) -> None:
        """Write the line of a message, if it has one."""
        match message.value:
            case Finding() as finding:
                self._decided(finding)
            case RigEvent(kind=kind) as event if kind != EventKind.BURST_ENDED:
                said = f" {event.burst}" * bool(event.burst) + f": {event.cause}" * bool(event.cause)
                log.info("%s: %s%s", self._machine, kind.replace("_", " "), said)
            case RetuneRequest() as request:
                log.info("%s: Q %s for %s asked for by %s", self._machine, request.name, request.found.fault, request.asked_by)
            case Notice(machine, level, sentence) if sentence not in self._said:
                log.log(LEVELS.get(level, logging.INFO), "%s", sentence if sentence.startswith(f"{machine}:") else f"{machine}: {sentence}")
            case AlarmChange() as change:
                self._alarm(change)

    def _decided(self, finding: Finding) -> None:
        e = finding.evidence
        quiet = e.trustworthy and not e.detected
        if not e.burst or (quiet and e.burst == self._quiet):
            return
        self._quiet = e.burst if quiet else self._quiet
        log.info("%s: %s: %s", self._machine, e.detector, _decision(e))
        self._said.append(sentence_of(finding))

    def _alarm(self, change: AlarmChange) -> None:
        a, by = change.alarm, f" by {change.who}" if change.who else ""
        why = f": {change.why}" if change.why and change.why not in self._said else ""
        self._said.append(change.why)
        what = f"{a.fault} {size(a.severity)}".rstrip()
        log.warning("%s: alarm %s (%s) %s%s%s", self._machine, a.id, what, change.event, by, why)

    def tick(self) -> None:
        """Pass."""

    def close(self) -> None:
        """Pass."""


def _decision(e: Evidence) -> str:
    """Return a decision in words, with its statistic and threshold where there are any."""
    found = f"{e.fault or 'a fault, not isolated' + ',' * bool(e.severity)} {size(e.severity)}".rstrip() if e.detected else "no fault"
    said = found if e.trustworthy else e.reason or "not trustworthy"
    return f"{said} (statistic {e.statistic:.3g}, threshold {e.threshold:.3g})" if math.isfinite(e.statistic) else said


def size(severity: Severity | None) -> str:
    """Return a severity in percent with its standard error, "" for none."""
    return "" if severity is None else f"{100 * severity.value:+.1f} ± {100 * severity.sd:.1f} %"


def sentence_of(finding: Finding) -> str:
    """Return a decision as one sentence for people."""
    e = finding.evidence
    how = f"{e.detector}: statistic {e.statistic:.3g} over threshold {e.threshold:.3g}"
    if e.fault and e.severity:
        return f"{e.machine}: {e.fault} {100 * e.severity.value:+.1f} % (+-{100 * e.severity.sd:.1f} %); {how}"
    likely = ", ".join(f"{name} {100 * w:.0f} %" for name, w in sorted(e.weights.items(), key=lambda i: -i[1])[:3])
    return f"{e.machine}: a fault; {how}" + (f"; between {likely}" if likely else "")
