"""The records of an MCAP file, intact or damaged: complete records are returned, everything else is named.

The reader of the ``mcap`` package trusts the end of a file and stops at the first fault. A recording cut short by a
crash has no end, and one bad chunk is no reason to lose those behind it.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError

from afdsvc.errors import BadInput
from afdsvc.files.tables.formats import opened
from afdsvc.files.validation import BOUNDS, items_in_time, recording_bytes, refuse_more

MAGIC = bytes([137, 77, 67, 65, 80, 48, 13, 10])
_PLAIN: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read, Opcode.METADATA: Metadata.read,
}  # fmt: skip
_FRAME = 9  # opcode and length in front of every record
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time, in front of a message's data


@dataclass(frozen=True, slots=True)
class Loss:
    """Bytes that could not be read: one sentence, and the time span [ns] they covered where that is known."""

    sentence: str
    start_ns: int = 0
    end_ns: int = 0


@dataclass(frozen=True, slots=True)
class _Frame:
    opcode: int
    content: bytes
    at: int


@dataclass(frozen=True, slots=True)
class End:
    """The end of the data; ``finished`` when the file was closed properly."""

    finished: bool


Item = McapRecord | Loss | End


def read_items(path: Path) -> Iterator[Item]:
    """Yield the records of the data section (those inside chunks one by one), losses where they are, and the end.

    Raises `BadInput` when the file cannot be opened, is no MCAP file, its chunks state more bytes than are read, or its records take
    too long. Memory is that of one chunk.
    """
    with opened(path) as file:
        size, start = os.fstat(file.fileno()).st_size, file.read(len(MAGIC))
        if start != MAGIC:
            raise BadInput(f"{path}: is not an MCAP file: it begins with {start!r}; expected an MCAP file, or a table with its own ending (.csv, .parquet, .mat, ...)" if start else f"{path}: is empty")
        refuse_more(path, _stated_bytes(file, size), recording_bytes(size), "bytes in its chunks")
        yield from items_in_time(_data(file, size), path, size)
        yield End(_finished(file, size))


def _data(file: BinaryIO, size: int) -> Iterator[Item]:
    for frame in _frames(file, size):
        if isinstance(frame, Loss):
            yield frame
        elif frame.opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break
        else:
            yield from _items(frame)


def is_finished(path: Path) -> bool:
    """Whether the file was closed properly; raises `BadInput` when it cannot be read."""
    try:
        with path.open("rb") as file:
            return _finished(file, path.stat().st_size)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None


def summary_channels(path: Path) -> Iterator[McapRecord]:
    """Yield the schemas and channels repeated behind the data of a finished file, those of damaged chunks too."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        behind = False
        for frame in _frames(file, size):
            behind = behind or (isinstance(frame, _Frame) and frame.opcode == Opcode.DATA_END)
            if behind and isinstance(frame, _Frame) and frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield from (item for item in _items(frame) if isinstance(item, McapRecord))


def _frames(file: BinaryIO, size: int) -> Iterator[_Frame | Loss]:
    """Yield every complete record as it is stored, and a loss where the file is damaged."""
    while _more(file):
        at, head = file.tell(), file.read(_FRAME)
        length = int.from_bytes(head[1:], "little")
        if len(head) < _FRAME or length > size - file.tell() or head[0] == 0:
            yield Loss(f"the last {size - at} bytes, from byte {at}, are no complete record: the file ends there")
            return
        yield _Frame(head[0], file.read(length), at)


def _stated_bytes(file: BinaryIO, size: int) -> int:
    """Return how many bytes the chunks say they hold, without those too large to be read; the file stays where it is."""
    begin, total = file.tell(), 0
    while len(head := file.read(_FRAME)) == _FRAME and head[0] not in (0, Opcode.DATA_END):
        at, length = file.tell(), int.from_bytes(head[1:], "little")
        if head[0] == Opcode.CHUNK:
            stated = int.from_bytes(file.read(24)[16:], "little")
            total += stated if stated <= BOUNDS.chunk else 0
        if length > size - at:
            break
        file.seek(at + length)
    file.seek(begin)
    return total


def _more(file: BinaryIO) -> bool:
    """Whether anything but the closing magic is left."""
    at = file.tell()
    rest = file.read(len(MAGIC) + 1)
    file.seek(at)
    return rest not in (b"", MAGIC)


def _items(frame: _Frame) -> Iterator[Item]:
    try:
        yield from _parsed(frame)
    except Exception as error:  # damaged bytes fail in as many ways as there are decoders below
        yield Loss(f"{_name(frame)} is damaged: {_why(error)}")


def _parsed(frame: _Frame) -> Iterator[Item]:
    stream = ReadDataStream(BytesIO(frame.content))
    if frame.opcode == Opcode.CHUNK:
        yield from _chunk(Chunk.read(stream), frame)
    elif frame.opcode == Opcode.MESSAGE:
        yield Message.read(stream, len(frame.content))
    elif frame.opcode == Opcode.ATTACHMENT:
        yield _attachment(frame.content)
    elif frame.opcode in _PLAIN:
        yield _PLAIN[frame.opcode](stream)
    elif frame.opcode not in (Opcode.HEADER, Opcode.MESSAGE_INDEX):
        yield Loss(f"{_name(frame)} is skipped")


def _chunk(chunk: Chunk, frame: _Frame) -> Iterator[Item]:
    try:
        yield from _inside(_inflated(chunk))
    except Exception as error:  # the decompressor's, the checksum's, or the record parser's own
        start, end = chunk.message_start_time, chunk.message_end_time
        span = f"{(end - start) / 1e9:.3f} s of data"
        yield Loss(f"{_name(frame)} with {span} is damaged: {_why(error)}", start, end)


def _inflated(chunk: Chunk) -> bytes:
    """Return the records of a chunk as bytes, as many as it states; raises `ValueError` when it holds more or others."""
    most = chunk.uncompressed_size
    if most > BOUNDS.chunk:
        raise ValueError(f"it states {most:,} bytes; at most {BOUNDS.chunk:,} are read")
    if chunk.compression == "zstd":
        data = bytes(zstandard.ZstdDecompressor().stream_reader(chunk.data).read(most + 1))
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"its compression '{chunk.compression[:20]}' is unknown; expected zstd or lz4")
    if len(data) != most:
        raise ValueError(f"it holds {'more' if len(data) > most else 'fewer'} bytes than the {most:,} it states")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise CRCValidationError(chunk.uncompressed_crc, zlib.crc32(data), chunk)
    return data


def _inside(data: bytes) -> Iterator[McapRecord]:
    """Yield schemas, channels and messages of a chunk; raises `ValueError` where a record does not fit."""
    at = 0
    while at < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        at += _FRAME
        if not opcode or length > len(data) - at:
            raise ValueError(f"a record of kind {opcode} with {length} bytes where {len(data) - at} are left")
        if opcode == Opcode.MESSAGE:
            id, sequence, logged, published = _MESSAGE.unpack_from(data, at)
            yield Message(
                channel_id=id, sequence=sequence, log_time=logged, publish_time=published, data=data[at + _MESSAGE.size : at + length]
            )
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield _PLAIN[opcode](ReadDataStream(BytesIO(data[at : at + length])))
        at += length


def _attachment(content: bytes) -> Item:
    attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
    stored = int.from_bytes(content[-4:], "little")
    if stored and stored != zlib.crc32(content[:-4]):
        return Loss(f"attachment '{attachment.name}' is damaged: wrong checksum")
    return attachment


def _finished(file: BinaryIO, size: int) -> bool:
    """Whether footer and closing magic are where a finished file has them."""
    footer = _FRAME + 20
    if size < 2 * len(MAGIC) + footer:
        return False
    file.seek(size - len(MAGIC) - footer)
    return file.read(1)[0] == Opcode.FOOTER and file.read(footer - 1 + len(MAGIC))[-len(MAGIC) :] == MAGIC


def _name(frame: _Frame) -> str:
    known = {int(o): o.name.lower().replace("_", " ") for o in Opcode}
    kind = known.get(frame.opcode, f"record of unknown kind {frame.opcode}")
    return f"the {kind} of {len(frame.content)} bytes at byte {frame.at}"


def _why(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


