"""A recording that was not closed, or is damaged, rewritten into one that every tool opens."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from afdsvc import __version__
from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_file import PROFILE, claim
from afdsvc.files.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class Recovered:
    """What was saved (messages by topic) and what was not (sentences, "" when nothing is missing)."""

    path: Path
    messages: Counter[str]
    loss: str


def recover(source: str | Path, target: str | Path) -> Recovered:
    """Copy everything readable into a new, finished file; raises `BadInput` when that exists or cannot be written."""
    recording, target = Recording(source), Path(target)
    try:
        with target.open("xb") as stream:
            _copy(recording, Writer(stream, compression=CompressionType.ZSTD))
            stream.flush()
            os.fsync(stream.fileno())
    except FileExistsError:
        raise BadInput(f"{target}: exists already; expected a new file") from None
    except OSError as error:
        raise BadInput(f"{target}: cannot be written: {error.strerror or error}") from None
    return Recovered(target, recording.counts, recording.loss)


def recover_in_place(path: str | Path) -> Recovered:
    """Close and index a recording whose writer died, under its own name.

    Where bytes in the middle are damaged the original is kept beside it as ``NAME.damaged``; a torn end holds nothing anybody
    could use. Raises `BadInput` when a running process is writing the file, or it is not a recording at all.
    """
    path = Path(path)
    try:
        with path.open("rb+") as stream:
            if not claim(stream):
                raise BadInput(f"{path}: is being written by a running process; it is closed when that ends")
    except FileNotFoundError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}; expected a recording") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be opened for writing: {error.strerror}") from None
    beside = path.with_name(path.name + ".recovering")
    beside.unlink(missing_ok=True)
    try:
        done = recover(path, beside)
        if "damaged" in done.loss:
            path.rename(path.with_name(path.name + ".damaged"))
        beside.replace(path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be replaced by what was recovered: {error.strerror}") from None
    finally:
        beside.unlink(missing_ok=True)
    return Recovered(path, done.messages, done.loss)


def _copy(recording: Recording, writer: Any) -> None:
    writer.start(PROFILE, f"afdsvc {__version__} recover")
    if recording.loss:
        writer.add_metadata("recovered", {"from": recording.path.name, "loss": recording.loss})
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for item in recording.records():
        _copy_record(item, writer, schemas, channels)
    writer.finish()


def _copy_record(item: McapRecord, writer: Any, schemas: dict[int, int], channels: dict[int, int]) -> None:
    if isinstance(item, Schema) and item.id not in schemas:
        schemas[item.id] = writer.register_schema(item.name, item.encoding, item.data)
    elif isinstance(item, Channel) and item.id not in channels:
        schema = schemas.get(item.schema_id, 0)
        channels[item.id] = writer.register_channel(item.topic, item.message_encoding, schema, item.metadata)
    elif isinstance(item, Message):
        channel = channels[item.channel_id]
        writer.add_message(channel, item.log_time, item.data, item.publish_time, item.sequence)
    elif isinstance(item, Attachment):
        writer.flush()
        writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
    elif isinstance(item, Metadata):
        writer.flush()
        writer.add_metadata(item.name, item.metadata)
