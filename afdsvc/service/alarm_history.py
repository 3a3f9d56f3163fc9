"""The history of alarms in SQLite: every change with time, person and reason, and the last state of every alarm."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from afdsvc.errors import BadInput
from afdsvc.wire import codec
from afdsvc.wire.messages import Alarm, AlarmChange

SCHEMA = """
CREATE TABLE IF NOT EXISTS change (
  number INTEGER PRIMARY KEY, t_ns INTEGER NOT NULL, alarm TEXT NOT NULL, machine TEXT NOT NULL, event TEXT NOT NULL,
  who TEXT NOT NULL, why TEXT NOT NULL, message BLOB NOT NULL
);
CREATE INDEX IF NOT EXISTS change_of_alarm ON change (alarm, number);
CREATE INDEX IF NOT EXISTS change_in_time ON change (t_ns);
"""
BUSY_SECONDS = 5.0
T = TypeVar("T")


@dataclass
class History:
    """A file of changes; each method opens it anew, so that any thread may call and a broken disk heals by itself.

    Raises `BadInput` naming the file when it cannot be read or written.
    """

    path: Path

    def add(self, *changes: AlarmChange) -> None:
        """Keep changes; when this returns they are on the disk."""
        rows = [(c.t_ns, c.alarm.id, c.alarm.machine, c.event, c.who, c.why, codec.encode(c)) for c in changes]
        insert = "INSERT INTO change (t_ns, alarm, machine, event, who, why, message) VALUES (?, ?, ?, ?, ?, ?, ?)"
        self._do(lambda db: db.executemany(insert, rows))

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
        """Drop changes before a time, but never the last one of an alarm; returns how many went."""
        old = "DELETE FROM change WHERE t_ns < ? AND number NOT IN (SELECT max(number) FROM change GROUP BY alarm)"
        return self._do(lambda db: db.execute(old, (before_ns,))).rowcount

    def _changes(self, query: str, arguments: tuple[object, ...]) -> list[AlarmChange]:
        rows = self._do(lambda db: db.execute(query, arguments).fetchall())
        return [codec.decode(AlarmChange, bytes(row[0])) for row in rows]

    def _do(self, action: Callable[[sqlite3.Connection], T]) -> T:
        try:
            with closing(sqlite3.connect(self.path, timeout=BUSY_SECONDS)) as db, db:
                db.executescript(SCHEMA)
                return action(db)
        except sqlite3.Error as error:
            raise BadInput(f"{self.path}: the alarm history cannot be used: {error}") from error
