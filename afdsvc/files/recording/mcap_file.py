"""One MCAP file being written: header first, channels as they are needed, chunks flushed so a crash loses little."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from afdsvc import __version__
from afdsvc.wire import afdsvc_pb2 as pb

try:
    import fcntl
except ImportError:  # only Unix has it
    fcntl = None  # type: ignore[assignment]

PROFILE = "afdsvc"
METADATA = "afdsvc"


@dataclass(frozen=True, slots=True)
class Header:
    """What makes a recording self-contained: texts of site file and models (by machine), and facts by name."""

    site: str = ""
    models: Mapping[str, str] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)


def claim(stream: BinaryIO) -> bool:
    """Mark a file as being written until it is closed; returns whether it was free (True where locks are not supported)."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True


class McapFile:
    """Writes one file; every method may raise OSError (disk full, folder gone), after which only `abandon` is left."""

    def __init__(self, path: Path, header: Header, overwrite: bool = False) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._stream = path.open("wb" if overwrite else "xb")
        claim(self._stream)
        self._writer: Any = Writer(self._stream, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._sequences: dict[int, int] = {}
        self._kept = 0  # bytes that were forced to the disk
        try:
            self._begin(header)
        except OSError:
            self.abandon()
            path.unlink(missing_ok=True)  # without its header it is of no use, and would stand in the way
            raise

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._stream.tell()

    def wire(self, topic: str, kind: str, t_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Append a message of ``afdsvc.v1``, the very bytes that came over the wire."""
        name = f"afdsvc.v1.{kind}"
        if name not in self._schemas:
            described = build_file_descriptor_set(getattr(pb, kind)).SerializeToString()
            self._schemas[name] = self._writer.register_schema(name, "protobuf", described)
        self._append(topic, name, t_ns, data, sequence, {})

    def message(
        self, topic: str, schema: tuple[str, bytes], t_ns: int, data: bytes, metadata: Mapping[str, str] | None = None
    ) -> None:
        """Append a message of any protobuf schema, given by name and description."""
        name, described = schema
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, "protobuf", described)
        self._append(topic, name, t_ns, data, None, metadata or {})

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Append an attachment; its time stays 0 so that equal runs give equal files."""
        self._writer.flush()
        self._writer.add_attachment(0, 0, name, media_type, data)

    def facts(self, name: str, facts: Mapping[str, str]) -> None:
        """Append metadata."""
        self._writer.flush()
        self._writer.add_metadata(name, dict(facts))

    def flush(self) -> None:
        """Force everything to the disk: what was flushed survives the death of this process and of the computer."""
        self._writer.flush()
        self._stream.flush()
        os.fdatasync(self._stream.fileno())
        self._kept = self.size

    def there(self) -> bool:
        """Whether the file still stands under its name, as long as it was: it may have been deleted, moved, replaced or cut."""
        try:
            named, written = os.stat(self.path), os.fstat(self._stream.fileno())
        except OSError:
            return False
        return os.path.samestat(named, written) and written.st_size >= self._kept

    def finish(self) -> None:
        """Write the index, force everything to the disk, and close."""
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Close without caring: the file stays readable up to its last complete chunk."""
        with contextlib.suppress(OSError):
            self._stream.close()

    def _begin(self, header: Header) -> None:
        self._writer.start(PROFILE, f"afdsvc {__version__}")
        self.facts(METADATA, {"version": __version__, **header.facts})
        if header.site:
            self.attach("site.toml", "application/toml", header.site.encode())
        for machine, text in ((m, t) for m, t in header.models.items() if t):
            self.attach(f"{machine}/model.toml", "application/toml", text.encode())
        self.flush()

    def _append(
        self, topic: str, schema: str, t_ns: int, data: bytes, sequence: int | None, metadata: Mapping[str, str]
    ) -> None:
        key = (topic, schema)
        if key not in self._channels:
            number = self._writer.register_channel(topic, "protobuf", self._schemas[schema], dict(metadata))
            self._channels[key] = number
        channel = self._channels[key]
        count = self._sequences.get(channel, 0) if sequence is None else sequence
        self._sequences[channel] = count + 1
        self._writer.add_message(channel, t_ns, data, t_ns, count & 0xFFFFFFFF)


BLOCK, RESIDUAL, EVENT, FINDING, REQUEST, RETUNING, DESCRIPTION, PREVIEW, LOG = (
    "block", "residual", "event", "evidence", "request", "retuning", "description", "preview", "log",
)  # fmt: skip


def topic(machine: str, what: str) -> str:
    """Return the topic of one kind of message of one machine: ``/bearing-1/block``."""
    return f"/{machine}/{what}"


def parts(name: str) -> tuple[str, str]:
    """Return machine and kind of a topic; ("", "") when it is not one of ours."""
    pieces = name.split("/")
    return (pieces[1], pieces[2]) if len(pieces) == 3 and not pieces[0] else ("", "")
