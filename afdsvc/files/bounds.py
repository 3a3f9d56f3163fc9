"""Bounds of every file that is read: what a small file may expand to, total size, columns; one table of them is in the docs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from afdsvc.errors import BadInput


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a file may hold; sizes in bytes after decompression.

    Tables are held in memory as a whole, recordings are read chunk by chunk; each may expand to its ``free`` size, beyond that to
    ``expansion`` times the size of the file.
    """

    table: int = 4_000_000_000
    table_free: int = 256_000_000
    table_expansion: int = 100
    recording_free: int = 1_000_000_000
    recording_expansion: int = 200
    chunk: int = 256_000_000
    columns: int = 4096
    line: int = 1_000_000
    text: int = 16_000_000


BOUNDS = Bounds()


def table_bytes(size: int) -> int:
    """Return how many bytes a table in a file of ``size`` bytes may hold."""
    return min(BOUNDS.table, max(BOUNDS.table_free, BOUNDS.table_expansion * size))


def recording_bytes(size: int) -> int:
    """Return how many bytes the chunks of a recording of ``size`` bytes may hold."""
    return max(BOUNDS.recording_free, BOUNDS.recording_expansion * size)


def refuse_more(path: Path, found: int, most: int, what: str) -> None:
    """Raise `BadInput` when a file holds more of something than it may."""
    if found > most:
        raise BadInput(f"{path}: holds {found:,} {what}; at most {most:,} are read from this file")


def file_size(path: Path, most: int) -> int:
    """Return the size of a file; raises `BadInput` when it is larger than ``most`` bytes or cannot be read."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    refuse_more(path, size, most, "bytes")
    return size
