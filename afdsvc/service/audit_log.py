"""The audit log: who asked the service for what, and the outcome; a file that only grows, each line sealed with those before it.

A line is a JSON object; its ``hash`` is SHA-256 over the line without it, and ``previous`` the hash of the line before. A line that is changed,
inserted or removed breaks the chain. Whoever can write the file can make it anew as a whole, or cut its end: against that, keep the number
and hash of a line elsewhere (each is in the service's own log too) and ask whether it is still there.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from afdsvc.api.clock import Clock
from afdsvc.errors import BadInput
from afdsvc.transport.outgoing_queue import OutgoingQueue

try:
    import fcntl
except ImportError:  # pragma: no cover - one service at a time writes where there are no locks
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)
FIRST = "0" * 64
LINE = 16_384  # characters of a line at most; longer arguments are replaced by their hash
TORN, LOST = "a line was cut off", "lines were lost"


class AuditLog:
    """Appends lines from a thread of its own: nobody waits for the disk. The next line that can be written says how many could not."""

    def __init__(self, path: Path, clock: Clock) -> None:
        self.path, self._clock, self._stated = path, clock, 0
        self._queue = OutgoingQueue(self._write, "audit log")

    def add(self, who: str, what: str, arguments: Mapping[str, Any] | None = None, outcome: str = "done") -> None:
        """Queue a line."""
        said = json.dumps(arguments or {}, sort_keys=True)
        if len(said) + len(outcome) > LINE // 2:
            said, outcome = json.dumps({"sha256": _digest(said.encode())}), outcome[:1000]
        line = {"time_ns": self._clock.now_ns(), "who": who[:200], "what": what[:200], "arguments": json.loads(said), "outcome": outcome}
        self._queue.publish("audit", json.dumps(line).encode())

    def close(self) -> None:
        """Write what is queued, and stop."""
        self._queue.close(1.0)

    def _write(self, _key: str, line: bytes) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        try:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX)
            number, previous, rest = _end(file)
            written, lost = b"\n" if rest else b"", self._queue.dropped - self._stated
            torn = [self._of_service(TORN, {"sha256": _digest(rest)})] if rest and _parsed(rest) is None else []
            gone = [self._of_service(LOST, {"count": lost})] if lost else []
            for entry in [*torn, *gone, json.loads(line)]:
                number += 1
                entry = {"number": number, **entry, "previous": previous}
                previous = _seal(entry)
                written += json.dumps({**entry, "hash": previous}).encode() + b"\n"
            if os.write(file, written) < len(written):
                raise OSError(errno.ENOSPC, "the disk is full")
            os.fsync(file)
            self._stated += lost
        finally:
            os.close(file)
        log.info("audit %d: %s: %s: %s %s", number, entry["who"], entry["what"], entry["outcome"], previous)

    def _of_service(self, what: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return {"time_ns": self._clock.now_ns(), "who": "service", "what": what, "arguments": arguments, "outcome": "done"}


@dataclass(frozen=True, slots=True)
class Audit:
    """What a check found: entries (newest last), number and hash of the last."""

    entries: tuple[Mapping[str, Any], ...]
    number: int
    hash: str


def verify_chain(path: Path, expected: str = "") -> Audit:
    """Check the whole chain and return its entries; raises `BadInput` naming the line that breaks it.

    ``expected`` is the hash of a line that was noted elsewhere and must still be there.
    """
    entries, previous = [], FIRST
    for number, entry in enumerate(_read(path), 1):
        where = f"{path}: line {number}"
        if entry.get("hash") != _seal(entry):
            raise BadInput(f"{where} does not fit its own hash: it was changed after it was written")
        if entry["previous"] != previous or entry["number"] != number:
            raise BadInput(f"{where} does not follow from the line before: lines were removed, inserted or exchanged")
        previous = str(entry["hash"])
        entries.append(entry)
    if expected and expected not in [e["hash"] for e in entries]:
        raise BadInput(f"{path}: no line has the hash {expected}: the log was cut, or made anew, since that was noted")
    return Audit(tuple(entries), len(entries), previous)


def _read(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the entries; a line that was cut off is skipped where the next entry vouches for it, or where it is the last."""
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    torn = ""
    for number, line in enumerate(lines, 1):
        entry = _parsed(line)
        if entry is None and number < len(lines):
            torn = _digest(line)
        elif entry is not None:
            if json.dumps(entry).encode() != line:
                raise BadInput(f"{path}: line {number} is not as it was written")
            if torn and (entry.get("what"), entry.get("arguments")) != (TORN, {"sha256": torn}):
                raise BadInput(f"{path}: line {number - 1} is not an entry: it was damaged after it was written")
            torn = ""
            yield entry
    if torn:
        raise BadInput(f"{path}: line {len(lines) - 1} is not an entry: it was damaged after it was written")


def _end(file: int) -> tuple[int, str, bytes]:
    """Return number and hash of the last entry, and what stands behind the last line's end."""
    size = os.fstat(file).st_size
    os.lseek(file, max(size - 4 * LINE, 0), os.SEEK_SET)
    *lines, rest = os.read(file, 4 * LINE).split(b"\n")
    last = next((entry for line in reversed([*lines, rest]) if (entry := _parsed(line))), None)
    return (int(last["number"]), str(last["hash"]), rest) if last else (0, FIRST, rest)


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) and {"number", "hash", "previous"} <= set(entry) else None


def _seal(entry: Mapping[str, Any]) -> str:
    return _digest(json.dumps({k: v for k, v in entry.items() if k != "hash"}, sort_keys=True).encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
