"""Bags of ROS 1 (`.bag`) and ROS 2 (`.db3`) as the records of an MCAP file, so that both are mapped alike."""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
from mcap.records import Channel, Message, Schema

from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_records import Item
from afdsvc.files.tables.formats import opened
from afdsvc.files.validation import BOUNDS, file_size, refuse_more

BAGS = (".bag", ".db3")
FIELDS = 65_536  # elements of arrays of fixed length in all types together: the library writes code for each


def read_bag(path: Path, is_mapped: Callable[[str], bool]) -> Generator[Item, None, None]:
    """Yield schema and channel of every topic, and the messages of the topics for which ``is_mapped(topic)``; raises `BadInput` for what is not a bag."""
    opened(path).close()
    try:
        yield from (_ros1 if path.suffix.lower() == ".bag" else _ros2)(path, is_mapped)
    except BadInput:
        raise
    except Exception as error:  # a bag that is none fails in many ways
        raise BadInput(f"{path}: not a readable bag: {type(error).__name__}: {error}") from None


def _library(path: Path) -> Any:
    try:
        import rosbags.rosbag1.reader
        import rosbags.typesys
    except ImportError:
        raise BadInput(f"{path}: a bag needs the extra 'ros': install afdsvc[ros]") from None
    return rosbags


def _ros1(path: Path, is_mapped: Callable[[str], bool]) -> Iterator[Item]:
    size = file_size(path, BOUNDS.table)

    library = _library(path).rosbag1.reader
    reader: Any = library.Reader

    class Bounded(reader):  # type: ignore[misc]
        def read_index_data(self, pos: int, indexes: Mapping[int, list[Any]]) -> None:
            """Every entry takes 12 bytes of the file, unless parts of it are read again and again."""
            super().read_index_data(pos, indexes)
            refuse_more(path, sum(map(len, indexes.values())), size // 12, "entries in its index")

    names = {function: name for name, function in library.decompressors.items()}
    with Bounded(path) as bag:
        bag.chunks = {at: chunk._replace(decompressor=partial(_inflated, names[chunk.decompressor])) for at, chunk in bag.chunks.items()}
        refuse_more(path, len(bag.connections), BOUNDS.columns, "topics")
        for c in bag.connections:
            yield Schema(c.id + 1, c.msgdef.data.encode(), "ros1msg", c.msgtype)
            yield Channel(c.id, c.topic, "ros1", {}, c.id + 1)
        if mapped := [c for c in bag.connections if is_mapped(c.topic)]:
            for c, t_ns, data in bag.messages(mapped):
                yield Message(c.id, t_ns, data, t_ns, 0)


_INFLATE: Mapping[str, Callable[[], Any]] = {"bz2": bz2.BZ2Decompressor, "lz4": lz4.frame.LZ4FrameDecompressor}


def _inflated(compression: str, data: bytes) -> bytes:
    found: bytes = _INFLATE[compression]().decompress(data, max_length=BOUNDS.chunk) if compression in _INFLATE else data
    if len(found) == BOUNDS.chunk:
        raise ValueError(f"a chunk holds {BOUNDS.chunk:,} bytes or more")
    return found


def _ros2(path: Path, is_mapped: Callable[[str], bool]) -> Iterator[Item]:
    size = file_size(path, BOUNDS.table)
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, 1_000_000))  # columns that are computed may be longer
        base.set_progress_handler(lambda: 0, 1_000_000)  # so that a query of hours ends with its thread
        tables = dict(base.execute("SELECT name, rootpage FROM sqlite_master WHERE type = 'table' LIMIT ?", (BOUNDS.columns,)))
        if not all(tables.get(name) for name in ("topics", "messages")):  # a view or a virtual table has no page
            raise ValueError("expected the tables 'topics' and 'messages' of rosbag2")
        topics = base.execute("SELECT id, name, type FROM topics LIMIT ?", (BOUNDS.columns,)).fetchall()
        for id, name, kind in topics:
            yield _schema(path, base, tables, id, kind)
            yield Channel(id, name, "cdr", {}, id + 1)
        mapped = [id for id, name, _ in topics if is_mapped(name)]
        held = ",".join("?" for _ in mapped)
        for id, t_ns, data in base.execute(f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({held})", mapped):
            yield Message(id, int(t_ns), bytes(data), int(t_ns), 0)


def _schema(path: Path, base: sqlite3.Connection, tables: Collection[str], id: int, kind: str) -> Schema:
    """Return the definition that the bag holds (since ROS 2 Iron), else that of ROS 2's own messages."""
    if "message_definitions" in tables:
        asked = "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type = ? LIMIT 1"
        for encoding, text in base.execute(asked, (kind,)):
            return Schema(id + 1, text.encode(), encoding, kind)
    types = _library(path).typesys
    own = types.get_typestore(types.Stores.ROS2_HUMBLE)
    return Schema(id + 1, own.generate_msgdef(kind, 2)[0].encode() if kind in own.fielddefs else b"", "ros2msg" if kind in own.fielddefs else "none", kind)


def ros1_decoder(schema: Schema, where: str) -> Callable[[bytes], Any]:
    """Return the function from the bytes of a ROS 1 message to its fields; raises `BadInput` for a definition that is none."""
    types = _library(Path(where)).typesys
    store = types.get_typestore(types.Stores.EMPTY)
    try:
        found = types.get_types_from_msg(schema.data.decode(), schema.name)
        _refuse_growth(found, where)
        store.register(found)
        store.get_msgdef(schema.name)
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"{where}: its schema cannot be read: {type(error).__name__}") from None
    return lambda data: store.deserialize_ros1(data, schema.name)


def _refuse_growth(types: Mapping[str, Any], where: str) -> None:
    """Raise `BadInput` for definitions by which a message of no bytes could hold any number of values."""
    fields = [desc for _, own in types.values() for _, desc in own]
    arrays = [inner for kind, inner in fields if kind == 3]
    refuse_more(Path(where), sum(length for _, length in arrays), FIELDS, "elements in arrays of fixed length")
    nested = {inner for kind, inner in [*fields, *(inner[0] for kind, inner in fields if kind > 2)] if kind == 2}
    if not all(length for _, length in arrays) or any(not types[name][1] for name in nested if name in types):
        raise BadInput(f"{where}: its type holds fields of no bytes; expected fields with a value")
