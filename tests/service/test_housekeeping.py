"""What a killed service left is closed at the next start; what is old goes while it runs; nothing else is touched."""

from __future__ import annotations

import itertools
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Block, Channel
from afdsvc.app import commissioning
from afdsvc.app.serve import SiteSinks
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import parse_site
from afdsvc.service.clock import RealClock
from afdsvc.service.housekeeping import Housekeeper, Keep, unfinished
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import Alarm, AlarmChange


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


def test_what_was_left_open_is_closed_and_reported(tmp_path):
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


def test_old_recordings_go_while_it_runs_and_it_is_reported(tmp_path):
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


SITE = """
site = "t"
recording = {{folder = "{folder}", {recording}}}
[[machines]]
id = "m1"
plant = "gas_bearing"
"""


def sinks_of(folder: Path, recording: str, plugins) -> tuple[SiteSinks, list]:
    """Return the sinks of a site, those of its machine begun."""
    site = parse_site(SITE.format(folder=folder, recording=recording), "t.toml")
    sinks = SiteSinks(site, RealClock())
    return sinks, sinks.of(commissioning.commission(site.machines[0], plugins))


def send(sinks: list, n: int) -> None:
    """Send blocks of noise, which no compression makes small, with pauses in which they are flushed."""
    rng = np.random.default_rng(1)
    for seq in range(n):
        block = Block("m1", "s1", seq, 50 * seq, 1e-3, 10**18 + seq, (Channel("u_x"), Channel("y_x")), rng.standard_normal((50, 2)))
        for sink in sinks:
            sink.take(Message(block, codec.encode_block(block)))
        if seq % 200 == 199:
            time.sleep(1.0)


def test_what_a_full_disk_cut_is_closed_once_there_is_room_while_the_service_runs(tmp_path, plugins):
    """The recording, and the minute before an alarm."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() != 0 or os.system(f"mount -t tmpfs -o size=500k none {disk} 2>/dev/null") != 0:
        pytest.skip("no right to mount a small disk here")
    try:
        sinks, (recorder, box) = sinks_of(disk, "preview_hz = 1", plugins)
        keeper = sinks.housekeeper()
        send([recorder, box], 1200)
        assert "No space left" in recorder.failure
        change = AlarmChange(Alarm("m1/a", "m1", "a", 1, 1), "raised", 1)
        (disk / "alarms").mkdir(exist_ok=True)
        os.system(f"mount -o remount,size=580k {disk}")
        box.take(Message(change))
        deadline = time.monotonic() + 60
        while not box.failure and time.monotonic() < deadline:
            time.sleep(0.02)
        assert "No space left" in box.failure
        cut = sorted(disk.rglob("*.mcap"))
        assert [path.parent.name for path in cut] == ["alarms", "disk"]
        kept = [[b.seq for b in Recording(path).blocks()] for path in cut]
        keeper._round()
        assert not any(map(is_finished, cut))
        os.system(f"mount -o remount,size=20m {disk}")
        keeper._round()
        assert all(map(is_finished, cut))
        assert [[b.seq for b in Recording(path).blocks()] for path in cut] == kept
        assert len(kept[1]) >= 200
        box.take(Message(change))
        sinks.close()
        assert len(list(Recording(disk / "alarms" / cut[0].name.replace("alarm-001", "alarm-002")).blocks())) == 1200
    finally:
        os.system(f"umount -l {disk}")


def test_a_recording_whose_copy_fills_the_disk_is_closed_later(tmp_path):
    """Found by the soak: the disk was filled while a recording was copied, which then waited for the next start."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() != 0 or os.system(f"mount -t tmpfs -o size=90m none {disk} 2>/dev/null") != 0:
        pytest.skip("no right to mount a small disk here")
    try:
        path, rng, said = disk / "m1-20261101T120000.mcap", np.random.default_rng(1), list[str]()
        recorder = Recorder(RecordingSettings(path, preview_hertz=0.0))
        for seq in range(100):
            block = Block("m1", "s1", seq, 12500 * seq, 1e-3, 10**18 + seq, (Channel("u_x"), Channel("y_x")), rng.standard_normal((12500, 2)))
            recorder.block(codec.encode_block(block), block)
        recorder.flush()
        recorder._file.abandon()
        recorder._file = None
        keeper = Housekeeper(disk, Keep(), {"m1"}, list, RealClock(), said.append)

        def fill() -> None:
            while not list(disk.glob("*.recovering")):
                time.sleep(0.001)
            with (disk / "others").open("wb") as file, suppress(OSError):  # until the disk is full, to which the copy adds meanwhile
                for start in itertools.count(0, 1_000_000):
                    os.posix_fallocate(file.fileno(), start, 1_000_000)

        filler = threading.Thread(target=fill)
        filler.start()
        keeper._round()
        filler.join()
        assert (said, is_finished(path)) == ([], False)
        (disk / "others").unlink()
        keeper._round()
        assert is_finished(path)
        assert len(list(Recording(path).blocks())) == 100
    finally:
        os.system(f"umount -l {disk}")


def test_recordings_of_the_service_that_runs_go_too_but_never_the_one_being_written(tmp_path, plugins):
    """Found by reading: what a service had written itself it never deleted, so that one that runs for months filled its disk."""
    sinks, (recorder, *_) = sinks_of(tmp_path, "preview_hz = 1, max_megabytes = 0.1, keep_megabytes = 0.15", plugins)
    send([recorder], 1200)
    written = sinks.files()
    assert len(written) > 4
    sinks.housekeeper()._tidy()
    left = [path for path in written if path.exists()]
    assert 1 <= len(left) < 4
    assert sinks.writing() == left[-1:] == written[-1:]
    sinks.close()
