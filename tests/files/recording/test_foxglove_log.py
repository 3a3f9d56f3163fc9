"""The log message is Foxglove's own, field by field."""

from google.protobuf.descriptor_pb2 import FileDescriptorSet

from afdsvc.files.recording.foxglove_log import NAME, SCHEMA, Level, encode_log


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
