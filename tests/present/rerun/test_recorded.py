"""From a recording to a Rerun file, and the viewer opened without telling anybody."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.signals import Channel, residual_block
from afdsvc.errors import BadInput
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.tables.tables import import_table, read_table
from afdsvc.present.rerun import open_viewer, review_recording, review_recordings
from afdsvc.present.rerun.blueprint import blueprint
from afdsvc.present.rerun.log import ReviewSink
from afdsvc.wire.codec import Message, encode, encode_block
from afdsvc.wire.messages import EventKind, Residual, RigEvent


@pytest.fixture
def recording(tmp_path, blocks, finding):
    recorder = Recorder(RecordingSettings(tmp_path / "run.mcap"))
    for block in blocks(12, bursts=(4, 5)):
        recorder.block(encode_block(block), block)
        residual = replace(
            block, channels=(Channel("aux_r_h", "um"), Channel("aux_r_v", "um")), values=block.values[:, :2]
        )
        recorder.residual(encode_block(residual), residual)
    event = RigEvent("m1", "s1", blocks(1)[0].t0_ns + 200_000_000, EventKind.BURST_STARTED, 200, "b4", "asked")
    recorder.event(encode(event), event)
    recorder.finding(encode(finding(0.3, 41.0)), finding(0.3, 41.0))
    recorder.close()
    return recorder.path


def test_everything_recorded_is_shown(recording, tmp_path, rrd):
    assert review_recording(recording, tmp_path / "out" / "a.rrd") == tmp_path / "out" / "a.rrd"
    file = rrd(tmp_path / "out" / "a.rrd")
    signals = ("outputs/y_h", "inputs/u_v", "excitation/alpha_h", "residual/beta_v", "whitened/r_h")
    assert file.entities >= {
        *(f"/m1/signals/{s}" for s in signals),
        "/m1/signals/whitened/_burst", "/m1/states/burst", "/m1/states/matched_filter", "/m1/log",
        "/m1/decisions/matched_filter/all\\ outputs",
    }  # fmt: skip
    assert [v for _, v in file.rows("/m1/log", "TextLog:text")] == [
        "burst 'b4' started: asked",
        "matched_filter detects sensor, severity -0.5 +- 0.1 (statistic 41, threshold 9)",
    ]


def test_every_sample_when_asked_for(recording, blocks, tmp_path, rrd):
    review_recording(recording, tmp_path / "a.rrd", every_sample=True)
    rows = rrd(tmp_path / "a.rrd").rows("/m1/signals/outputs/y_v")
    assert np.array([v for _, v in rows]).tobytes() == np.concatenate([b.column("y_v") for b in blocks(12)]).tobytes()


def test_live_and_from_the_recording_it_looks_the_same(recording, blocks, finding, tmp_path, rrd):
    review_recording(recording, tmp_path / "later.rrd")
    sink = ReviewSink(tmp_path / "live.rrd")
    for block in blocks(12, bursts=(4, 5)):
        sink.take(Message(block, b""))
        sink.take(Message(Residual(residual_block(block, block.values[:, :2]))))
    sink.take(Message(finding(0.3, 41.0)))
    sink.close()
    live, later = rrd(tmp_path / "live.rrd"), rrd(tmp_path / "later.rrd")
    for entity in sorted(live.entities):
        if "_burst" not in entity and entity != "/m1/log":
            assert live.rows(entity) == later.rows(entity), entity


def test_without_a_name_it_goes_to_a_folder_of_its_own(recording):
    made = review_recording(recording)
    try:
        assert made.name == "run.rrd"
        assert made.stat().st_size > 1000
    finally:
        made.unlink()
        made.parent.rmdir()


def test_an_imported_table_is_shown_without_empty_views(tmp_path, rrd, monkeypatch):
    (tmp_path / "t.csv").write_text("t,u_a,y_b\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(100)))
    path = import_table(read_table(tmp_path / "t.csv"), tmp_path / "t.mcap")
    layouts = []
    monkeypatch.setattr(
        "afdsvc.present.rerun.log.blueprint", lambda found, *rest, real=blueprint: layouts.append(found) or real(found, *rest)
    )
    file = rrd(review_recording(path, tmp_path / "t.rrd"))
    assert {e for e in file.entities if not e.endswith("_burst")} == {
        "/table/answer", "/table/signals/inputs/u_a", "/table/signals/outputs/y_b",
    }  # fmt: skip
    [layout] = layouts[-1].values()
    assert (layout.lanes, layout.reported, dict(layout.detectors)) == (0, False, {})


def test_a_recording_without_samples_is_named(tmp_path):
    Recorder(RecordingSettings(tmp_path / "empty.mcap")).close()
    with pytest.raises(BadInput, match=r"empty\.mcap: holds no samples"):
        review_recording(tmp_path / "empty.mcap", tmp_path / "a.rrd")


def test_the_viewer_reports_to_nobody_and_listens_on_loopback(tmp_path, monkeypatch):
    calls = []

    class Done:
        returncode = 0

    monkeypatch.setattr("subprocess.run", lambda command, **_: calls.append(command[1:]) or Done)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    if sys.platform == "linux":
        with pytest.raises(BadInput, match=r"there is no display for the viewer; expected --save FILE\.rrd"):
            open_viewer(tmp_path / "a.rrd")
    assert calls == []
    monkeypatch.setenv("DISPLAY", ":0")
    assert open_viewer(tmp_path / "a.rrd") == 0
    assert calls[0] == ["-m", "rerun", "analytics", "disable"]
    assert calls[1] == ["-m", "rerun", "--bind", "127.0.0.1", "--port", "auto", str(tmp_path / "a.rrd")]


def test_several_recordings_stand_side_by_side_each_from_its_own_beginning(recording, blocks, tmp_path, rrd):
    later = Recorder(RecordingSettings(tmp_path / "later.mcap"))
    for block in blocks(6):
        moved = replace(block, t0_ns=block.t0_ns + 10**12)
        later.block(encode_block(moved), moved)
    later.close()
    review_recordings([recording, tmp_path / "later.mcap"], tmp_path / "both.rrd")
    file = rrd(tmp_path / "both.rrd")
    first, second = (file.rows(f"/{name}.m1/signals/outputs/y_h") for name in ("run", "later"))
    assert first[0][0] == second[0][0] == 0
    assert max(t for t, _ in second) < 300_000_000


def test_recordings_of_one_name_are_numbered(recording, tmp_path, rrd):
    (tmp_path / "other").mkdir()
    copy = tmp_path / "other" / recording.name
    copy.write_bytes(recording.read_bytes())
    review_recordings([recording, copy], tmp_path / "both.rrd")
    assert {e.split("/")[1] for e in rrd(tmp_path / "both.rrd").entities} == {"1.\\ run.m1", "2.\\ run.m1"}
