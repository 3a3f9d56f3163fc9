"""Who learns of changes of alarms and of judged bursts: the history, which outlasts restarts, and notifiers, each behind a queue and thread of its own."""

from __future__ import annotations

import logging
import queue
import sqlite3
import threading
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import astuple, dataclass
from functools import partial
from itertools import chain, repeat
from pathlib import Path
from typing import Any, TypeVar

from afdsvc.errors import BadInput
from afdsvc.wire import codec
from afdsvc.wire.messages import Alarm, AlarmChange

log = logging.getLogger(__name__)
PAUSES = (1.0, 5.0, 25.0)  # seconds between attempts; after the last the change is given up and counted


class NotificationQueue:
    """Hands changes to ``receive`` in order; one that fails is tried again, then dropped, counted and logged.

    ``receive`` gets up to ``batch`` changes that wait together as its arguments. A ``patient`` queue tries without end and drops only what it
    has no room for.
    """

    def __init__(
        self, name: str, receive: Callable[..., object], pauses: tuple[float, ...] = PAUSES, size: int = 1000, batch: int = 1,
        patient: bool = False,
    ) -> None:  # fmt: skip
        self.name, self._receive, self._pauses = name, receive, pauses
        self._patient = patient
        self._queue: queue.Queue[AlarmChange | Judged | None] = queue.Queue(size)
        self._stopping, self._batch = threading.Event(), batch
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name=f"alarms to {name}", daemon=True)
        self._thread.start()

    def put(self, change: AlarmChange | Judged) -> None:
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

    def _take(self) -> list[AlarmChange | Judged | None]:
        """Return what waits, at most a batch and up to the end; waits for the first."""
        taken: list[AlarmChange | Judged | None] = [self._queue.get()]
        while taken[-1] is not None and len(taken) < self._batch:
            try:
                taken.append(self._queue.get_nowait())
            except queue.Empty:
                break
        return taken

    def _hand_over(self, changes: list[AlarmChange | Judged]) -> None:
        for pause in chain(self._pauses, repeat(self._pauses[-1]) if self._patient else (None,)):
            last = pause is None or self._stopping.is_set()
            try:
                self._receive(*changes)
                self.failure = ""
                return
            except Exception as error:
                self._report(f"{type(error).__name__}: {error}")
            if last:
                break
            self._stopping.wait(pause)
        for change in changes:
            self._drop(change, self.failure)

    def _report(self, failure: str) -> None:
        """Note why nothing can be handed over; a patient queue, which drops nothing, logs it once."""
        if self._patient and not self.failure:
            log.error("alarms to %s: %s; tried again until it is over", self.name, failure)
        self.failure = failure

    def _drop(self, change: AlarmChange | Judged, why: str) -> None:
        self.dropped += 1
        what = f"alarm {change.alarm.id} ({change.event})" if isinstance(change, AlarmChange) else f"the decisions on burst {change.burst}"
        log.error("%s could not be delivered to %s: %s", what, self.name, why)


SCHEMA = """
CREATE TABLE IF NOT EXISTS change (
  number INTEGER PRIMARY KEY, t_ns INTEGER NOT NULL, alarm TEXT NOT NULL, machine TEXT NOT NULL, event TEXT NOT NULL,
  who TEXT NOT NULL, why TEXT NOT NULL, message BLOB NOT NULL
);
CREATE INDEX IF NOT EXISTS change_of_alarm ON change (alarm, number);
CREATE INDEX IF NOT EXISTS change_in_time ON change (t_ns);
CREATE TABLE IF NOT EXISTS judged (
  machine TEXT NOT NULL, burst TEXT NOT NULL, t_ns INTEGER NOT NULL, fault TEXT NOT NULL, value REAL, sd REAL, PRIMARY KEY (machine, burst)
);
CREATE INDEX IF NOT EXISTS judged_in_time ON judged (machine, t_ns);
"""
BUSY_SECONDS = 5.0
T = TypeVar("T")


def _rows(db: sqlite3.Connection, query: str, arguments: tuple[object, ...]) -> list[tuple[Any, ...]]:
    return db.execute(query, arguments).fetchall()


@dataclass(frozen=True, slots=True)
class Judged:
    """What the decisions on a burst amount to: the fault ("" where there is none) with its severity, None where none was estimated."""

    machine: str
    burst: str
    t_ns: int
    fault: str = ""
    value: float | None = None
    sd: float | None = None


@dataclass
class History:
    """A file of changes; each method opens it anew, so that any thread may call and a broken disk heals by itself.

    Raises `BadInput` naming the file when it cannot be read or written.
    """

    path: Path

    def add(self, *kept: AlarmChange | Judged) -> None:
        """Keep changes and judged bursts, of which a later one replaces an earlier one; when this returns they are on the disk."""
        changes = [(c.t_ns, c.alarm.id, c.alarm.machine, c.event, c.who, c.why, codec.encode(c)) for c in kept if isinstance(c, AlarmChange)]
        judged = [astuple(j) for j in kept if isinstance(j, Judged)]
        self._do(lambda db: (
            db.executemany("INSERT INTO change (t_ns, alarm, machine, event, who, why, message) VALUES (?, ?, ?, ?, ?, ?, ?)", changes),
            db.executemany("INSERT OR REPLACE INTO judged VALUES (?, ?, ?, ?, ?, ?)", judged),
        ))  # fmt: skip

    def judged(self, machine: str, limit: int = 20_000) -> list[Judged]:
        """Return the newest judged bursts of a machine, oldest first."""
        query = "SELECT * FROM judged WHERE machine = ? ORDER BY t_ns DESC LIMIT ?"
        return [Judged(*row) for row in self._do(lambda db: db.execute(query, (machine, limit)).fetchall())][::-1]

    def merge(self, changes: Iterable[AlarmChange]) -> None:
        """Keep the changes that are not kept yet: those of another service of the site, oldest first."""
        for change in changes:
            known = "SELECT 1 FROM change WHERE t_ns = ? AND alarm = ? AND event = ?"
            if not self._do(partial(_rows, query=known, arguments=(change.t_ns, change.alarm.id, change.event))):
                self.add(change)

    def handover(self, limit: int = 1000) -> list[AlarmChange]:
        """Return the newest changes and the last one of every alarm, oldest first."""
        kept = "number IN (SELECT max(number) FROM change GROUP BY alarm) OR number > (SELECT max(number) FROM change) - ?"
        return self._changes(f"SELECT message FROM change WHERE {kept} ORDER BY number", (limit,))

    def last(self) -> list[Alarm]:
        """Return every alarm as it stood after its last change."""
        newest = "SELECT message FROM change WHERE number IN (SELECT max(number) FROM change GROUP BY alarm) ORDER BY number"
        return [c.alarm for c in self._changes(newest, ())]

    def changes(self, alarm: str = "", limit: int = 1000) -> list[AlarmChange]:
        """Return the newest changes (of one alarm), oldest first."""
        where, arguments = ("WHERE alarm = ?", (alarm,)) if alarm else ("", ())
        found = self._changes(f"SELECT message FROM change {where} ORDER BY number DESC LIMIT ?", (*arguments, limit))
        return found[::-1]

    def forget(self, before_ns: int) -> int:
        """Drop what is older than a time, but never the last change of an alarm; returns how many rows went."""
        old = "DELETE FROM change WHERE t_ns < ? AND number NOT IN (SELECT max(number) FROM change GROUP BY alarm)"
        judged = "DELETE FROM judged WHERE t_ns < ?"
        return self._do(lambda db: db.execute(old, (before_ns,)).rowcount + db.execute(judged, (before_ns,)).rowcount)

    def _changes(self, query: str, arguments: tuple[object, ...]) -> list[AlarmChange]:
        rows = self._do(partial(_rows, query=query, arguments=arguments))
        return [codec.decode(AlarmChange, bytes(row[0])) for row in rows]

    def _do(self, action: Callable[[sqlite3.Connection], T]) -> T:
        try:
            with closing(sqlite3.connect(self.path, timeout=BUSY_SECONDS)) as db, db:
                db.executescript(SCHEMA)
                return action(db)
        except sqlite3.Error as error:
            raise BadInput(f"{self.path}: the alarm history cannot be used: {error}") from error
