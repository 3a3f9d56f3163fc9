"""Housekeeping of recordings: those that a killed service or a full disk left are closed; the oldest are deleted, never the one being written."""

from __future__ import annotations

import logging
import re
import shutil
import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

from afdsvc.api.clock import Clock
from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.recover import recover_in_place

_OURS = re.compile(r"(?P<machine>.+)-\d{8}T\d{6}(-\d+)?(\.\d{4})?(-alarm-\d{3,}-[\w.-]+)?\.(mcap|rrd)")


LEAP_SECONDS = 30 * 86400.0  # a pause between recordings that may as well be a clock that leapt


@dataclass(frozen=True, slots=True)
class Keep:
    """What a folder of recordings may hold: bytes in all, and seconds since a file was last written; None: no bound."""

    bytes: float | None = None
    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class Removed:
    """A recording that was deleted and why, or could not be."""

    path: Path
    why: str


def recordings(folder: Path) -> list[Path]:
    """Return the recordings the service made in a folder (by their names), oldest first; other files are ignored."""
    found = [(p.stat().st_mtime, p) for p in folder.glob("*") if _OURS.fullmatch(p.name) and p.is_file()] if folder.is_dir() else []
    return [path for _, path in sorted(found)]


def machine_of_file(path: Path) -> str:
    """Return the machine a recording's name speaks of, "" for another file."""
    match = _OURS.fullmatch(path.name)
    return match["machine"] if match else ""


def trusted_since(times: Collection[float], seconds: float, now: float) -> float:
    """Return the time [s] before which the ages of recordings written at ``times`` are no reason to delete them.

    Infinite when none is younger than ``seconds``: everything would go. Otherwise the end of the last pause that is longer than
    ``seconds`` and `LEAP_SECONDS`: in it the clock may have leapt.
    """
    if all(now - t > seconds for t in times):
        return float("inf")
    return max((b for a, b in pairwise([*sorted(times), now]) if b - a > max(seconds, LEAP_SECONDS)), default=float("-inf"))


def tidy(folder: Path, keep: Keep, busy: Collection[Path], now: float, since: float = float("-inf")) -> list[Removed]:
    """Delete what ``keep`` does not allow and return it; ``busy`` files are counted but stay. ``now`` is Unix time [s].

    Files last written before ``since`` [s] do not go because of their age; see `trusted_since`.
    """
    found = [(p, p.stat()) for p in recordings(folder)]
    total = sum(s.st_size for _, s in found)
    removed = []
    for path, stat in found:
        why = _why(keep, total, now - stat.st_mtime if stat.st_mtime >= since else 0.0)
        if not why or path in busy:
            continue
        try:
            path.unlink()
        except OSError as error:
            why = f"{why}, but cannot be deleted: {error.strerror}"
        total -= stat.st_size
        removed.append(Removed(path, why))
    return removed


def _why(keep: Keep, total: int, age: float) -> str:
    if keep.seconds is not None and age > keep.seconds:
        return f"is {age / 86400:.1f} days old, more than the {keep.seconds / 86400:g} days that are kept"
    if keep.bytes is not None and total > keep.bytes:
        return f"is the oldest of {total / 1e6:.1f} MB, more than the {keep.bytes / 1e6:g} MB that are kept"
    return ""


log = logging.getLogger(__name__)
TIDY_SECONDS = 60.0
ROOM = 2  # times the size of an unfinished recording: its copy must not fill the disk
LEAPT_SECONDS = 3600.0  # by which wall clock and monotonic clock may part while the service runs


def unfinished(folder: Path, machines: Collection[str]) -> list[Path]:
    """Return the recordings of these machines that were never closed, those of alarms too; call it before any is begun."""
    found = [p for p in recordings(folder) if p.suffix == ".mcap" and machine_of_file(p) in machines]
    found += [p for p in sorted((folder / "alarms").glob("*.mcap")) if machine_of_file(_of_alarm(p)) in machines]
    return [p for p in found if not is_finished(p)]


def _room(path: Path) -> bool:
    return shutil.disk_usage(path.parent).free > ROOM * path.stat().st_size


def _of_alarm(path: Path) -> Path:
    """Return the recording a file of an alarm (``RECORDING-alarm-001-fault.mcap``) belongs to."""
    return path.with_name(f"{path.name.split('-alarm-')[0]}.mcap")


class Housekeeper:
    """Works in a thread of its own while the service runs; ``writing()`` returns the files being written, ``torn()`` those that could not be written to their end.

    ``alarms`` is what the files of alarms, in their own folder, are kept for; ``chores`` are done with every round.
    While the clock may have leapt, nothing is deleted because of its age, no chore is done, and this is reported once.
    What it does is reported by ``say(sentence)`` and in the log.
    """

    def __init__(
        self, folder: Path, keep: Keep, machines: Collection[str], writing: Callable[[], list[Path]], clock: Clock,
        say: Callable[[str], None] = lambda sentence: None, alarms: Keep = Keep(), chores: Sequence[Callable[[], object]] = (),
        torn: Callable[[], list[Path]] = list,
    ) -> None:  # fmt: skip
        self._alarms, self._chores, self._torn = alarms, chores, torn
        self._folder, self._keep, self._writing, self._clock, self._say = folder, keep, writing, clock, say
        self._waiting = unfinished(folder, machines)
        self._offset, self._reported = self._wall_offset(), ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="housekeeping", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """Stop; a recovery in progress is left to the next start."""
        self._stop.set()
        self._thread.join(2)

    def _work(self) -> None:
        self._round()
        while not self._stop.wait(TIDY_SECONDS):
            self._round()

    def _round(self) -> None:
        waiting, self._waiting = [*self._waiting, *self._torn()], []
        for path in waiting:
            if self._stop.is_set():
                return
            self._guarded(partial(self._recover, path))
        self._guarded(self._tidy)
        for work in self._chores if self._since(self._alarms) < float("inf") else ():
            self._guarded(work)

    def _recover(self, path: Path) -> None:
        """Close and index a recording, later where there is no room for its copy; one that was deleted is gone."""
        if not path.exists():
            return
        done = None
        try:
            done = recover_in_place(path) if _room(path) else None
        except BadInput as error:
            if _room(path):
                return self._tell(f"an unfinished recording could not be closed: {error}")
        if done is None:
            self._waiting.append(path)
        else:
            self._tell(f"closed and indexed, {sum(done.messages.values())} messages: {done.loss}")

    def _tidy(self) -> None:
        for folder, keep in ((self._folder, self._keep), (self._folder / "alarms", self._alarms)):
            now, since = self._clock.now_ns() / 1e9, self._since(keep)
            for removed in tidy(folder, keep, self._writing(), now, since):
                self._tell(f"{removed.path}: deleted: it {removed.why}")
            self._report_kept(folder, keep, now, since)

    def _since(self, keep: Keep) -> float:
        """Return from which time on the ages of files are trusted: never, when the clock leapt while the service runs."""
        if abs(self._wall_offset() - self._offset) > LEAPT_SECONDS:
            return float("inf")
        busy = set(self._writing())
        files = [p for folder in (self._folder, self._folder / "alarms") for p in recordings(folder) if p not in busy]
        times = [p.stat().st_mtime for p in files]
        return trusted_since(times, keep.seconds or 0.0, self._clock.now_ns() / 1e9) if times else float("-inf")

    def _report_kept(self, folder: Path, keep: Keep, now: float, since: float) -> None:
        kept = [p for p in recordings(folder) if keep.seconds is not None and now - keep.seconds > p.stat().st_mtime < since]
        sentence = f"{folder}: recordings older than what is kept stay, because the clock may have leapt: nothing younger is there, or there is a long pause"
        if kept and sentence != self._reported:
            self._reported = sentence
            self._tell(f"{sentence}; delete them by hand when they are as old as they look ({len(kept)} now, the newest {kept[-1].name})")

    def _wall_offset(self) -> float:
        return self._clock.now_ns() / 1e9 - self._clock.monotonic()

    def _tell(self, sentence: str) -> None:
        log.warning("%s", sentence)
        self._say(sentence)

    def _guarded(self, work: Callable[[], object]) -> None:
        try:
            work()
        except BadInput as error:
            log.error("housekeeping failed: %s", error)
        except Exception:
            log.exception("housekeeping failed")
