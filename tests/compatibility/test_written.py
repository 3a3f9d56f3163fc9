"""What is written today has the form of what commit 09e6b58 wrote, so that older readers of these files go on."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

CHANGING = ("version", "software")


def contents(path: Path) -> dict[str, Any]:
    """Return all a recording holds: messages as bytes with the names of their schemas, attachments, facts but for the version."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        messages = [(s and (s.name, s.encoding), c.topic, m.log_time, m.data) for s, c, m in reader.iter_messages()]
        facts = {m.name: {k: v for k, v in m.metadata.items() if k not in CHANGING} for m in reader.iter_metadata()}
        return {"messages": messages, "facts": facts, "attached": {a.name: a.data for a in reader.iter_attachments()}}


def fields(path: Path) -> set[tuple[str, str, int, int, int]]:
    """Return message, name, number, type and label of every field that the schemas of a recording describe."""
    with path.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()  # type: ignore[union-attr]
    described = [f for s in schemas if s.encoding == "protobuf" for f in FileDescriptorSet.FromString(s.data).file]
    return {(m.name, f.name, f.number, f.type, f.label) for d in described for m in d.message_type for f in m.field}


def test_an_imported_recording_byte_by_byte(files, run):
    run("import run.csv --out new.mcap --model plain.toml", files)
    old, new = contents(files / "imported.mcap"), contents(files / "new.mcap")
    assert len(old["messages"]) > 60
    assert new == old
    assert fields(files / "imported.mcap") <= fields(files / "new.mcap")  # fields may be added, none may change


def test_an_identified_model(files, run):
    run("identify stated.toml run.csv --holdout held.csv --out new.toml", files)
    old, new = (tomllib.loads((files / name).read_text()) for name in ("identified.toml", "new.toml"))
    assert {k: type(v) for k, v in new.items()} == {k: type(v) for k, v in old.items()}
    assert all(new[k] == old[k] for k in ("name", "time", "sample_time", "inputs", "outputs", "noise", "controller"))


def test_a_recovered_recording_has_every_message_that_was_whole(files, run):
    run("recover torn.mcap --out whole.mcap", files)
    whole, original = contents(files / "whole.mcap"), contents(files / "recording.mcap")
    assert set(whole["messages"]) < set(original["messages"])
    assert len(whole["messages"]) > 100
    assert whole["attached"] == original["attached"]
