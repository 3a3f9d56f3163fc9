"""The committed messages are the ones the .proto file gives."""

import shutil
from pathlib import Path

import pytest

from afdsvc.wire import regenerate


def description_in(generated: Path) -> str:
    return next(line for line in generated.read_text().splitlines() if "AddSerializedFile" in line)


def test_committed_messages_fit_the_proto_file(tmp_path, monkeypatch):
    pytest.importorskip("grpc_tools")
    here = regenerate.HERE
    shutil.copy(here / "afdsvc.proto", tmp_path)
    monkeypatch.setattr(regenerate, "HERE", tmp_path)
    assert regenerate.run_protoc() == 0
    assert description_in(tmp_path / "afdsvc_pb2.py") == description_in(here / "afdsvc_pb2.py")
