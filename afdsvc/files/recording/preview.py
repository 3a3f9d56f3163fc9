"""One message per sample at about 100 Hz, for viewers that plot message fields.

Every n-th sample is shown as it is, so fast signals alias: a preview shows where to look, the blocks what was there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.message_factory import GetMessageClass

from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.schemas import file_set, pool_of

_TIMESTAMP, _INDEX, _FIRST = 1, 2, 3


class Preview:
    """The message of one set of channels: ``timestamp``, ``k``, and a double of each channel's name."""

    def __init__(self, channels: tuple[Channel, ...], number: int) -> None:
        self.channels = channels
        self.fields = field_names(channels)
        package, message = f"afdsvc.preview{number}", "Sample"
        self.schema_name = f"{package}.{message}"
        file = _description(package, message, self.fields)
        self.schema = file_set(file)
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


def field_names(channels: tuple[Channel, ...]) -> tuple[str, ...]:
    """Return the channels' names as identifiers protobuf accepts, all different."""
    names: list[str] = []
    for channel in channels:
        name = re.sub(r"[^A-Za-z0-9_]", "_", channel.name)
        while name in names:
            name += "_"
        names.append(name)
    return tuple(names)


def _description(package: str, message: str, fields: tuple[str, ...]) -> FileDescriptorProto:
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
