"""Protobuf descriptions as MCAP wants them: a set of files, dependencies first."""

from __future__ import annotations

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool


def timestamp_file() -> FileDescriptorProto:
    """Return the description of ``google.protobuf.Timestamp``."""
    return FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)


def pool_of(file: FileDescriptorProto) -> DescriptorPool:
    """Return a pool that holds a file and the time stamp it uses."""
    pool = DescriptorPool()
    pool.Add(timestamp_file())
    pool.Add(file)
    return pool


def file_set(file: FileDescriptorProto) -> bytes:
    """Return the schema bytes of a file whose only dependency is the time stamp."""
    return FileDescriptorSet(file=[timestamp_file(), file]).SerializeToString()
