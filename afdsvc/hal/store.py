"""Store and forward: blocks of samples that the service has not acknowledged are kept on the rig's disk and delivered later."""

from __future__ import annotations

import logging
import os
import struct
import threading
import zlib
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from afdsvc.api.clock import Clock
from afdsvc.api.intervals import Intervals
from afdsvc.api.signals import Block
from afdsvc.errors import BadInput, Refused
from afdsvc.files.recording.mcap_file import claim
from afdsvc.wire import codec
from afdsvc.wire.messages import Receipt

log = logging.getLogger(__name__)
SPILL_SECONDS = 5.0  # what is not acknowledged for so long goes to the disk; in normal operation nothing does
DELIVER_SECONDS = 20.0  # after it went there it is delivered: short outages are delivered from the publisher's memory
AGAIN_SECONDS = 20.0  # after which what was delivered, but not acknowledged, is delivered again
WINDOW = 4  # segments delivered and not yet acknowledged, at most
SEGMENT_BYTES = 8_000_000
MOST_FRESH = 4000  # blocks in memory
HEAD = struct.Struct("<II")  # length and CRC-32 of a record
Samples = tuple[str, int, int]


@dataclass
class _Segment:
    """A file of records, and the samples in it as (session, first, end); it is ``open`` to further ones until a write fails or it is delivered."""

    path: Path
    held: list[Samples] = field(default_factory=list)
    bytes: int = 0
    open: bool = False
    written: float = float("-inf")
    delivered: float = float("-inf")


class Store:
    """Keeps the blocks of one machine until they are acknowledged, at most ``most_bytes`` on the disk; the oldest go first.

    `encode` is called by the thread that publishes, `receive` by the network's, `tick` by a thread that may wait for the disk.
    """

    def __init__(self, folder: Path, machine: str, most_bytes: float, clock: Clock) -> None:
        self._folder, self._machine, self._most, self._clock = folder, machine, most_bytes, clock
        self._lock = threading.Lock()
        self._fresh: deque[tuple[float, str, int, int, bytes]] = deque()
        self._taken: dict[str, Intervals] = defaultdict(Intervals)
        self._heard = float("-inf")
        self._segments: list[_Segment] | None = None
        self._claimed: BinaryIO | None = None
        self._failed = ""
        self.lost: dict[str, Intervals] = defaultdict(Intervals)  # samples that were not kept: the store was full, or failed

    def claim(self) -> None:
        """Keep other agents of the machine away until `close`; raises `Refused` where this computer has one already.

        Two agents would mix their blocks in one file.
        """
        path = self._folder / f"{self._machine}.lock"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("ab")
        except OSError as error:
            return self._report(error)
        if claim(file):
            self._claimed = file
        else:
            file.close()
            raise Refused(f"machine '{self._machine}' has a rig agent already: it holds {path}")

    def encode(self, block: Block) -> bytes:
        """Return the bytes of a block, which is kept from now on."""
        data = codec.encode_block(block)
        with self._lock:
            self._fresh.append((self._clock.monotonic(), block.session, block.k0, block.k0 + len(block), data))
            if len(self._fresh) > MOST_FRESH:  # the disk hangs
                self.lost[self._fresh[0][1]].add(*self._fresh.popleft()[2:4])
        return data

    def receive(self, receipt: Receipt) -> None:
        """Take note of what the service has recorded."""
        with self._lock:
            self._heard = self._clock.monotonic()
            for session, start, end in receipt.ranges:
                self._taken[session].add(start, end)
            self._fresh = deque(b for b in self._fresh if not self._taken[b[1]].covers(b[2], b[3]))

    def tick(self, deliver: Callable[[bytes], object]) -> None:
        """Move what is not acknowledged to the disk; deliver a piece of what is there, oldest first, while the service acknowledges.

        ``deliver(data)`` returns when the service has the block, or raises.
        """
        now = self._clock.monotonic()
        self._spill(now - SPILL_SECONDS)
        try:
            self._forget()
        except OSError as error:
            return self._report(error)
        due = [s for s in self._held()[:WINDOW] if now - s.written > DELIVER_SECONDS and now - s.delivered > AGAIN_SECONDS]
        if due and self.acknowledged:
            self._deliver(min(due, key=lambda s: s.delivered), deliver)

    @property
    def acknowledged(self) -> bool:
        """Whether a service is there that acknowledges what it records."""
        return self._clock.monotonic() - self._heard < SPILL_SECONDS

    def close(self) -> None:
        """Move everything that is not acknowledged to the disk: it is delivered after the next start."""
        self._spill(float("inf"))
        if self._claimed is not None:
            self._claimed.close()

    @property
    def waiting(self) -> int:
        """Bytes on the disk."""
        return sum(s.bytes for s in self._segments or ())

    def _held(self) -> list[_Segment]:
        """Return the segments, those of an earlier start among them."""
        if self._segments is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._segments = [self._found(path) for path in sorted(self._folder.glob(f"{self._machine}.[0-9]*.blocks"))]
        return self._segments

    def _found(self, path: Path) -> _Segment:
        """Return what an earlier start left: nothing is appended to it, its last record may be cut."""
        return _Segment(path, [samples for samples, _ in blocks(path)], path.stat().st_size)

    def _spill(self, before: float) -> None:
        with self._lock:
            old = []
            while self._fresh and self._fresh[0][0] <= before:
                old.append(self._fresh.popleft())
        for _, session, start, end, data in old:
            try:
                self._append(session, start, end, data)
            except OSError as error:
                self.lost[session].add(start, end)
                self._report(error)
        if old and self._segments:
            self._sync(self._segments[-1].path)

    def _report(self, error: OSError) -> None:
        """Log a failure of the disk once, until it is over."""
        if self._failed != (why := error.strerror or str(error)):
            log.error("%s: blocks cannot be kept: %s", self._folder, why)
        self._failed = why

    def _append(self, session: str, start: int, end: int, data: bytes) -> None:
        segments = self._held()
        if not segments or not segments[-1].open or segments[-1].bytes + len(data) > SEGMENT_BYTES:
            number = int(segments[-1].path.name.split(".")[-2]) + 1 if segments else 0
            segments.append(_Segment(self._folder / f"{self._machine}.{number:010d}.blocks"))
        record, last = HEAD.pack(len(data), zlib.crc32(data)) + data, segments[-1]
        last.open = False  # what follows a cut record could not be read
        with last.path.open("ab") as file:
            file.write(record)
        last.open = True
        last.held.append((session, start, end))
        last.bytes += len(record)
        last.written = self._clock.monotonic()
        while self.waiting > self._most and len(segments) > 1:
            self._drop(segments.pop(0))
        self._failed = ""

    def _drop(self, segment: _Segment) -> None:
        for session, start, end in segment.held:
            if not self._recorded(session, start, end):
                self.lost[session].add(start, end)
        segment.path.unlink(missing_ok=True)

    def _forget(self) -> None:
        """Delete the segments whose samples have all been recorded."""
        for segment in list(self._held()):
            if all(self._recorded(*samples) for samples in segment.held):
                self._held().remove(segment)
                segment.path.unlink(missing_ok=True)

    def _deliver(self, segment: _Segment, deliver: Callable[[bytes], object]) -> None:
        held, segment.open = [], False
        for samples, data in blocks(segment.path):  # one by one: a service that is behind refuses the first
            held.append(samples)
            if not self._recorded(*samples):
                deliver(data)
                self._spill(self._clock.monotonic() - SPILL_SECONDS)  # a busy service takes a file in a minute
        for session, start, end in set(segment.held) - set(held):  # the disk damaged them
            self.lost[session].add(start, end)
        segment.held = held
        segment.delivered = self._clock.monotonic()

    def _recorded(self, session: str, start: int, end: int) -> bool:
        with self._lock:
            return self._taken[session].covers(start, end)

    @staticmethod
    def _sync(path: Path) -> None:
        with path.open("rb") as file:
            os.fsync(file.fileno())

    def statement(self) -> Mapping[str, list[tuple[int, int]]]:
        """Return, once, the samples that could not be kept, as (first, after the last) by session."""
        lost, self.lost = self.lost, defaultdict(Intervals)
        return {session: ranges.pairs() for session, ranges in lost.items()}


def blocks(path: Path) -> Iterator[tuple[Samples, bytes]]:
    """Yield the blocks of a file, their samples and bytes; what cannot be decoded, such as zeros in place of a record, is left out."""
    for data in records(path):
        with suppress(BadInput):
            block = codec.decode_block(data)
            yield (block.session, block.k0, block.k0 + len(block)), data


def records(path: Path) -> Iterator[bytes]:
    """Yield the whole records of a file: a power failure may have cut the last, and a damaged one is left out."""
    with path.open("rb") as file:
        while len(head := file.read(HEAD.size)) == HEAD.size:
            size, sum = HEAD.unpack(head)
            data = file.read(min(size, SEGMENT_BYTES + 1))
            if len(data) < size:
                return
            if zlib.crc32(data) == sum:
                yield data
