"""What a killed service left is closed at the next start; what is old goes while it runs; nothing else is touched."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.service.clock import RealClock
from afdsvc.service.housekeeping import Housekeeper, Keep, unfinished
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
        os.utime(path, 2 * (time.time() - 2 * 86400,))
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
    old, busy, new = (tmp_path / f"m1-2026110{day}T120000.mcap" for day in (1, 2, 3))
    for path in (old, busy, new):
        path.write_bytes(bytes(10))
    for path in (old, busy):
        os.utime(path, 2 * (time.time() - 2 * 86400,))
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


class SetClock(RealClock):
    """A real clock whose wall time is set forward."""

    ahead = 0.0

    def now_ns(self) -> int:
        return super().now_ns() + round(1e9 * self.ahead)


@pytest.mark.parametrize("when", ["before the start", "while it runs"])
def test_a_clock_that_leaps_a_year_ahead_deletes_nothing(tmp_path, when):
    days = {tmp_path / f"m1-202611{day:02d}T120000.mcap": 20 - day for day in range(1, 20)}
    for path, age in days.items():
        path.write_bytes(bytes(10))
        os.utime(path, 2 * (time.time() - 86400 * age,))
    said: list[str] = []
    done: list[str] = []
    clock = SetClock()
    clock.ahead = 365 * 86400.0 if when == "before the start" else 0.0
    keeper = Housekeeper(tmp_path, Keep(seconds=30 * 86400.0), {"other"}, list, clock, said.append, chores=[lambda: done.append("chore")])
    clock.ahead = 365 * 86400.0
    keeper._tidy()
    keeper._tidy()
    assert all(path.exists() for path in days)
    assert len(said) == 1
    assert "because the clock may have leapt" in said[0]
    keeper.start()
    keeper.close()
    assert done == []


def test_after_a_leap_new_recordings_do_not_make_the_old_ones_go(tmp_path):
    """The clock of the computer stays a year ahead: what is written then looks a year younger than what is there."""
    now = time.time()
    ages = {"m1-20261101T120000.mcap": 366.0, "m1-20261102T120000.mcap": 365.0, "m1-20271101T120000.mcap": 40.0, "m1-20271201T120000.mcap": 0.1}
    for name, age in ages.items():
        (tmp_path / name).write_bytes(bytes(10))
        os.utime(tmp_path / name, 2 * (now - 86400 * age,))
    Housekeeper(tmp_path, Keep(seconds=60 * 86400.0), {"other"}, list, RealClock())._tidy()
    assert all((tmp_path / name).exists() for name in ages)
    Housekeeper(tmp_path, Keep(seconds=35 * 86400.0), {"other"}, list, RealClock())._tidy()
    assert [name for name in ages if not (tmp_path / name).exists()] == []
    os.utime(tmp_path / "m1-20271201T120000.mcap", 2 * (now - 86400 * 20,))
    Housekeeper(tmp_path, Keep(seconds=35 * 86400.0), {"other"}, list, RealClock())._tidy()
    assert [name for name in ages if not (tmp_path / name).exists()] == ["m1-20271101T120000.mcap"]
