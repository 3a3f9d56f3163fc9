"""What a killed service left is closed at the next start; what is old goes while it runs; nothing else is touched."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.recording.retention import Keep
from afdsvc.service.clock import RealClock
from afdsvc.service.housekeeping import Housekeeper, unfinished
from afdsvc.wire import codec


def torn(path: Path) -> Path:
    """Write a recording and leave it as a killed process would."""
    path.parent.mkdir(exist_ok=True)
    block = Block("m1", "s1", 0, 0, 1e-3, 10**18, (Channel("u_x"), Channel("y_x")), np.ones((50, 2)))
    recorder = Recorder(RecordingSettings(path))
    recorder.block(codec.encode_block(block), block)
    recorder.flush()
    recorder._file.abandon()
    recorder._file = None
    return path


def test_what_was_left_open_is_closed_and_told(tmp_path):
    mine = [torn(tmp_path / "m1-20261101T120000.0001.mcap"), torn(tmp_path / "alarms" / "m1-20261101T120000-alarm-001-pump.mcap")]
    others = [torn(tmp_path / "m2-20261101T120000.mcap"), torn(tmp_path / "measured.mcap")]
    assert unfinished(tmp_path, {"m1"}) == mine
    said: list[str] = []
    keeper = Housekeeper(tmp_path, Keep(), {"m1"}, list, RealClock(), said.append)
    keeper.start()
    deadline = time.monotonic() + 10
    while not all(map(is_finished, mine)) and time.monotonic() < deadline:
        time.sleep(0.02)
    keeper.close()
    assert all(map(is_finished, mine))
    assert not any(map(is_finished, others))
    assert [len(list(Recording(p).blocks())) for p in mine] == [1, 1]
    assert all("closed and indexed" in s and "was not closed" in s for s in said)


def test_files_of_alarms_go_by_their_own_age_and_chores_are_done_though_one_fails(tmp_path):
    folder = tmp_path / "alarms"
    folder.mkdir()
    old, new = folder / "m1-20261101T120000-alarm-001-unnamed.mcap", folder / "m1-20261101T120000-alarm-002-pump.b.mcap"
    foreign = folder / "notes.mcap"
    for path in (old, new, foreign):
        path.write_bytes(bytes(10))
    for path in (old, foreign):
        os.utime(path, (1.0, 1.0))
    done: list[str] = []

    def fails() -> None:
        raise OSError("no")

    chores = [fails, lambda: done.append("chore")]
    keeper = Housekeeper(tmp_path, Keep(), {"other"}, list, RealClock(), alarms=Keep(seconds=86400.0), chores=chores)
    keeper.start()
    deadline = time.monotonic() + 10
    while (old.exists() or not done) and time.monotonic() < deadline:
        time.sleep(0.02)
    keeper.close()
    assert done == ["chore"]
    assert [p.exists() for p in (old, new, foreign)] == [False, True, True]


def test_old_recordings_go_while_it_runs_and_it_is_told(tmp_path):
    old, busy = tmp_path / "m1-20261101T120000.mcap", tmp_path / "m1-20261102T120000.mcap"
    for path in (old, busy):
        path.write_bytes(bytes(10))
        os.utime(path, (1.0, 1.0))
    said: list[str] = []
    keeper = Housekeeper(tmp_path, Keep(seconds=86400.0), {"other"}, lambda: [busy], RealClock(), said.append)
    keeper.start()
    deadline = time.monotonic() + 10
    while old.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    keeper.close()
    assert not old.exists()
    assert busy.exists()
    assert len(said) == 1
    assert "deleted: it is" in said[0]
