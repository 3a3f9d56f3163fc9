"""What other viewers of a recording show: its log in sentences, and a thinned preview of its signals."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import IntEnum
from typing import Any

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput
from afdsvc.wire.messages import EventKind, RigEvent


def _timestamp_file() -> FileDescriptorProto:
    """Return the description of ``google.protobuf.Timestamp``."""
    return FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)


def pool_of(file: FileDescriptorProto) -> DescriptorPool:
    """Return a pool that holds a file and the time stamp it uses."""
    pool = DescriptorPool()
    pool.Add(_timestamp_file())
    pool.Add(file)
    return pool


def _file_set(file: FileDescriptorProto) -> bytes:
    """Return the schema bytes of a file whose only dependency is the time stamp."""
    return FileDescriptorSet(file=[_timestamp_file(), file]).SerializeToString()


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
SCHEMA = _file_set(_FILE)


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


_TIMESTAMP, _INDEX, _FIRST = 1, 2, 3


class Preview:
    """The message of one set of channels: ``timestamp``, ``k``, and a double of each channel's name."""

    def __init__(self, channels: tuple[Channel, ...], number: int) -> None:
        self.channels = channels
        self.fields = _field_names(channels)
        package, message = f"afdsvc.preview{number}", "Sample"
        self.schema_name = f"{package}.{message}"
        file = _file_descriptors(package, message, self.fields)
        self.schema = _file_set(file)
        self.metadata = {f"unit.{f}": c.unit for f, c in zip(self.fields, channels, strict=True)}
        self._message = GetMessageClass(pool_of(file).FindMessageTypeByName(self.schema_name))

    def messages(self, block: Block, hertz: float) -> Iterator[tuple[int, bytes]]:
        """Yield time [ns] and bytes of every sample whose index is a multiple of the stride for about ``hertz``."""
        stride = max(1, round(1 / (block.dt * hertz)))
        for i in range(-block.k0 % stride, len(block), stride):
            t_ns = block.t0_ns + round(i * block.dt * 1e9)
            message = self._message(k=block.k0 + i, **dict(zip(self.fields, block.values[i].tolist(), strict=True)))
            message.timestamp.seconds, message.timestamp.nanos = divmod(t_ns, 10**9)  # type: ignore[attr-defined]
            yield t_ns, message.SerializeToString()


def _field_names(channels: tuple[Channel, ...]) -> tuple[str, ...]:
    """Return the channels' names as identifiers protobuf accepts, all different."""
    names: list[str] = []
    for channel in channels:
        name = re.sub(r"[^A-Za-z0-9_]", "_", channel.name)
        while name in names:
            name += "_"
        names.append(name)
    return tuple(names)


def _file_descriptors(package: str, message: str, fields: tuple[str, ...]) -> FileDescriptorProto:
    F = FieldDescriptorProto
    file = FileDescriptorProto(
        name=f"{package}.proto", package=package, dependency=["google/protobuf/timestamp.proto"], syntax="proto3"
    )
    sample = file.message_type.add(name=message)
    stamp = ".google.protobuf.Timestamp"
    sample.field.add(
        name="timestamp", number=_TIMESTAMP, label=F.LABEL_OPTIONAL, type=F.TYPE_MESSAGE, type_name=stamp
    )
    sample.field.add(name="k", number=_INDEX, label=F.LABEL_OPTIONAL, type=F.TYPE_UINT64)
    for number, name in enumerate(fields, start=_FIRST):
        sample.field.add(name=name, number=number, label=F.LABEL_OPTIONAL, type=F.TYPE_DOUBLE)
    return file


_WORDS = {
    EventKind.RIG_STARTED: "rig started",
    EventKind.RIG_STOPPED: "rig stopped",
    EventKind.BURST_STARTED: "burst '{burst}' started",
    EventKind.BURST_ENDED: "burst '{burst}' ended",
    EventKind.BURST_ABORTED: "burst '{burst}' cut short",
    EventKind.BURST_REFUSED: "burst '{burst}' refused",
    EventKind.FAULT_INJECTED: "simulated fault set in",
    EventKind.NOTE: "note",
    EventKind.RETUNED: "retuned with '{burst}'",
    EventKind.RESTORED: "restored, '{burst}' has gone",
    EventKind.RETUNE_REFUSED: "Q '{burst}' refused",
}
_WARNINGS = {EventKind.BURST_ABORTED, EventKind.BURST_REFUSED, EventKind.RESTORED, EventKind.RETUNE_REFUSED}


def event_sentence(event: RigEvent) -> tuple[Level, str]:
    """Return level and sentence of an event of a rig."""
    text = _WORDS[event.kind].format(burst=event.burst)
    level = Level.WARNING if event.kind in _WARNINGS else Level.INFO
    return level, f"{text}: {event.cause}" if event.cause else text


def evidence_sentence(evidence: Evidence) -> tuple[Level, str]:
    """Return level and sentence of a decision."""
    e = evidence
    who = e.detector + (f" on {e.output}" if e.output else "")
    if not e.trustworthy:
        return Level.WARNING, f"{who} is not trusted: {e.reason}"
    numbers = f"statistic {e.statistic:.4g}, threshold {e.threshold:.4g}"
    if not e.detected:
        return Level.INFO, f"{who} finds nothing ({numbers})"
    severity = f", severity {e.severity.value:+.3g} +- {e.severity.sd:.2g}" if e.severity else ""
    return Level.ERROR, f"{who} detects {e.fault or 'a change, cause not singled out'}{severity} ({numbers})"


class DecisionLog:
    """Lets a decision through when it differs from the same detector's previous one; one entry per detector is kept."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str, str], tuple[bool, bool, str | None]] = {}

    def worth_telling(self, evidence: Evidence) -> bool:
        """Whether the verdict is new for this machine, detector and output; the first "nothing" is not."""
        who = (evidence.machine, evidence.detector, evidence.output)
        now = (evidence.detected, evidence.trustworthy, evidence.fault)
        changed = self._last.get(who, (False, True, None)) != now
        self._last[who] = now
        return changed
