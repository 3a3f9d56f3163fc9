"""Events as ``foxglove.Log``, the message log panels of MCAP viewers know.

The layout is the one published in Foxglove's schema registry (https://docs.foxglove.dev/docs/sdk/schemas/log); it is
described here so that recording needs no package of theirs.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from afdsvc.errors import BadInput
from afdsvc.files.recording.schemas import file_set, pool_of

NAME = "foxglove.Log"


class Level(IntEnum):
    """How much a person should care."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


def _description() -> FileDescriptorProto:
    F = FieldDescriptorProto
    fields = [
        ("timestamp", F.TYPE_MESSAGE, ".google.protobuf.Timestamp"), ("level", F.TYPE_ENUM, ".foxglove.Log.Level"),
        ("message", F.TYPE_STRING, None), ("name", F.TYPE_STRING, None), ("file", F.TYPE_STRING, None),
        ("line", F.TYPE_FIXED32, None),
    ]  # fmt: skip
    log = DescriptorProto(name="Log")
    for number, (name, kind, type_name) in enumerate(fields, start=1):
        log.field.add(name=name, number=number, label=F.LABEL_OPTIONAL, type=kind, type_name=type_name)
    levels = log.enum_type.add(name="Level")
    for number, name in enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")):
        levels.value.add(name=name, number=number)
    dependency = ["google/protobuf/timestamp.proto"]
    file = FileDescriptorProto(name="foxglove/Log.proto", package="foxglove", dependency=dependency, syntax="proto3")
    file.message_type.append(log)
    return file


_FILE = _description()
# A pool of our own: the default one may already hold this file when a program uses Foxglove's package as well.
_LOG = GetMessageClass(pool_of(_FILE).FindMessageTypeByName(NAME))
SCHEMA = file_set(_FILE)


def encode_log(t_ns: int, level: Level, text: str, name: str) -> bytes:
    """Return a log message; ``name`` says who speaks (a machine)."""
    message = _LOG(level=int(level), message=text, name=name)
    message.timestamp.seconds, message.timestamp.nanos = divmod(t_ns, 10**9)  # type: ignore[attr-defined]
    return message.SerializeToString()


def decode_log(data: bytes) -> tuple[int, Level, str, str]:
    """Return time [ns], level, text and speaker of a log message; raises `BadInput` for other bytes."""
    try:
        message: Any = _LOG.FromString(data)
        t_ns = message.timestamp.seconds * 10**9 + message.timestamp.nanos
        return t_ns, Level(min(max(message.level, Level.DEBUG), Level.ERROR)), message.message, message.name
    except (DecodeError, ValueError) as error:
        raise BadInput(f"{len(data)} bytes are not a {NAME} message: {error}") from None
