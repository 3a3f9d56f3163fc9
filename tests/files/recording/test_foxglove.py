"""The log message is Foxglove's own, field by field."""

from __future__ import annotations

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.foxglove import NAME, SCHEMA, Level, Preview, encode_log


def plain(schema: bytes) -> list[bytes]:
    files = FileDescriptorSet.FromString(schema).file
    for file in files:
        file.ClearField("source_code_info")
        for message in file.message_type:
            for field in message.field:
                field.ClearField("json_name")  # derived from the name
    return [file.SerializeToString(deterministic=True) for file in files if file.package == "foxglove"]


def test_layout_is_the_published_one():
    from foxglove.messages import Log

    theirs = Log.get_schema()
    assert (theirs.name, theirs.encoding) == (NAME, "protobuf")
    assert plain(SCHEMA) == plain(theirs.data)


def test_bytes_are_the_ones_their_package_writes():
    from foxglove.messages import Log, LogLevel, Timestamp

    t_ns = 1_763_000_000_123_456_789
    theirs = Log(
        timestamp=Timestamp(sec=t_ns // 10**9, nsec=t_ns % 10**9), level=LogLevel.Warning, message="Å: slow", name="m1"
    )
    assert encode_log(t_ns, Level.WARNING, "Å: slow", "m1") == theirs.encode()


CHANNELS = tuple(Channel(f"aux_{i}", "um") for i in range(20))  # from the 14th on tags have two bytes
DOUBLES = st.floats(allow_nan=False)


@given(st.integers(0, 2**60), st.integers(0, 2**61), st.lists(st.sampled_from([0.0, -0.0, 1.5, np.inf, 1e-300]) | DOUBLES, min_size=20, max_size=20))
def test_the_library_reads_what_was_written(k0: int, t0_ns: int, row: list[float]) -> None:
    preview = Preview(CHANNELS, 1)
    values = np.vstack([row, np.zeros(20), row[::-1]])
    block = Block("m", "s", 0, 3 * (k0 // 3), 1e-3, t0_ns, CHANNELS, values)
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(preview.schema).file:
        pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName(preview.schema_name))
    reported = list(preview.messages(block, 1000.0))
    assert len(reported) == 3
    for i, (t_ns, data) in enumerate(reported):
        read = message.FromString(data)
        assert read.timestamp.seconds * 10**9 + read.timestamp.nanos == t_ns == t0_ns + i * 10**6
        assert read.k == block.k0 + i
        assert np.array([getattr(read, f) for f in preview.fields]).tobytes() == values[i].tobytes()


def test_samples_are_those_whose_index_is_a_multiple_of_the_stride() -> None:
    block = Block("m", "s", 0, 7, 1e-3, 0, CHANNELS[:1], np.arange(50.0)[:, None])
    assert [t for t, _ in Preview(CHANNELS[:1], 1).messages(block, 100.0)] == [3_000_000, 13_000_000, 23_000_000, 33_000_000, 43_000_000]
