"""The committed messages are the ones the .proto file gives."""

import shutil
from pathlib import Path

import pytest

from benchmarks.support import regenerate_messages


def description_in(generated: Path) -> str:
    return next(line for line in generated.read_text().splitlines() if "AddSerializedFile" in line)


def test_committed_messages_fit_the_proto_file(tmp_path, monkeypatch):
    pytest.importorskip("grpc_tools")
    here = regenerate_messages.HERE
    shutil.copy(here / "afdsvc.proto", tmp_path)
    monkeypatch.setattr(regenerate_messages, "HERE", tmp_path)
    assert regenerate_messages.run_protoc() == 0
    assert description_in(tmp_path / "afdsvc_pb2.py") == description_in(here / "afdsvc_pb2.py")
