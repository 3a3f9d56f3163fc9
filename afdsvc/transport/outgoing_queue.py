"""Outgoing messages behind a bounded queue: a stalled network delays neither control nor detection."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)
Publish = Callable[[str, bytes], None]


class OutgoingQueue:
    """Hands messages to ``publish`` in order, from a thread of its own.

    When ``size`` messages wait, later ones are dropped and counted; a ``patient`` post makes the sender wait instead, which
    is right for a recording that is replayed and wrong for anything that moves. Nothing is sent before ``ready`` is set (None: at
    once); what is queued until then waits.
    """

    def __init__(
        self, publish: Publish, name: str = "post", size: int = 4000, patient: bool = False, ready: threading.Event | None = None
    ) -> None:
        self._publish, self._patient, self._ready = publish, patient, ready
        self._queue: queue.Queue[tuple[str, Callable[..., bytes], tuple[Any, ...]] | None] = queue.Queue(size)
        self._leaving = threading.Event()
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Number of messages not yet sent."""
        return self._queue.qsize()

    def send(self, key: str, encode: Callable[..., bytes], *value: Any) -> None:
        """Queue ``encode(*value)`` for a key; returns at once unless the post is patient."""
        item = (key, encode, value)
        if not self._patient:
            return self._put(item)
        while not self._leaving.is_set():
            try:
                return self._queue.put(item, timeout=0.5)
            except queue.Full:
                continue

    def publish(self, key: str, payload: bytes) -> None:
        """Queue bytes for a key."""
        self.send(key, bytes, payload)

    def close(self, seconds: float = 1.5) -> None:
        """Send what waits as far as the time goes; what cannot be sent is counted as dropped."""
        deadline = time.monotonic() + seconds
        while self._is_ready() and self._queue.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.005)
        self._leaving.set()
        self.dropped += self._queue.qsize()
        try:
            self._queue.put_nowait(None)
        except queue.Full:
            log.debug("%s: left full", self._thread.name)
        self._thread.join(max(deadline - time.monotonic(), 0.05))

    def _put(self, item: tuple[str, Callable[..., bytes], tuple[Any, ...]]) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.dropped += 1

    def _is_ready(self) -> bool:
        return self._ready is None or self._ready.is_set()

    def _work(self) -> None:
        while self._ready is not None and not self._ready.wait(0.1):
            if self._leaving.is_set():
                return
        while (item := self._queue.get()) is not None and not self._leaving.is_set():
            key, encode, value = item
            try:
                self._publish(key, encode(*value))
                self.failure = ""
            except Exception as error:
                self._fail(f"{key}: {type(error).__name__}: {error}")
            finally:
                self._queue.task_done()

    def _fail(self, sentence: str) -> None:
        self.dropped += 1
        if not self.failure:
            log.warning("a message could not be sent to %s", sentence)
        self.failure = sentence
