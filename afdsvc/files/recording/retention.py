"""Retention: recordings beyond the limits of age or number are deleted, oldest first, never the one being written."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

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
