"""One receiver of alarm changes behind a bounded queue and a thread of its own: it never blocks the service."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable

from afdsvc.wire.messages import AlarmChange

log = logging.getLogger(__name__)
PAUSES = (1.0, 5.0, 25.0)  # seconds between attempts; after the last the change is given up and counted


class NotificationQueue:
    """Hands changes to ``receive`` in order; one that fails is tried again, then dropped, counted and logged.

    ``receive`` gets up to ``batch`` changes that wait together as its arguments.
    """

    def __init__(
        self, name: str, receive: Callable[..., object], pauses: tuple[float, ...] = PAUSES, size: int = 1000, batch: int = 1
    ) -> None:
        self.name, self._receive, self._pauses = name, receive, pauses
        self._queue: queue.Queue[AlarmChange | None] = queue.Queue(size)
        self._stopping, self._batch = threading.Event(), batch
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=f"alarms to {name}", daemon=True)
        self._thread.start()

    def put(self, change: AlarmChange) -> None:
        """Queue a change; when the queue is full it is dropped and counted."""
        try:
            self._queue.put_nowait(change)
        except queue.Full:
            self._drop(change, "the queue is full")

    def flush(self, seconds: float) -> bool:
        """Wait until everything queued has been handed over; returns whether it has."""
        waiter = threading.Thread(target=self._queue.join, daemon=True)
        waiter.start()
        waiter.join(seconds)
        return not waiter.is_alive()

    def close(self, seconds: float = 5.0) -> None:
        """Hand over what is queued as far as it goes without waiting for retries, and stop."""
        self._stopping.set()
        try:
            self._queue.put(None, timeout=seconds)
        except queue.Full:
            log.error("alarms to %s: the queue is full; %d changes are lost", self.name, self._queue.qsize())
        self._thread.join(seconds)

    def _work(self) -> None:
        while True:
            taken = self._take()
            changes = [change for change in taken if change is not None]
            try:
                if changes:
                    self._hand_over(changes)
                if None in taken:
                    return
            finally:
                for _ in taken:
                    self._queue.task_done()

    def _take(self) -> list[AlarmChange | None]:
        """Return what waits, at most a batch and up to the end; waits for the first."""
        taken = [self._queue.get()]
        while taken[-1] is not None and len(taken) < self._batch:
            try:
                taken.append(self._queue.get_nowait())
            except queue.Empty:
                break
        return taken

    def _hand_over(self, changes: list[AlarmChange]) -> None:
        for pause in (*self._pauses, None):
            try:
                self._receive(*changes)
                self.failure = ""
                return
            except Exception as error:
                self.failure = f"{type(error).__name__}: {error}"
            if pause is None or self._stopping.wait(pause):
                break
        for change in changes:
            self._drop(change, self.failure)

    def _drop(self, change: AlarmChange, why: str) -> None:
        self.dropped += 1
        log.error("alarm %s (%s) could not be delivered to %s: %s", change.alarm.id, change.event, self.name, why)
