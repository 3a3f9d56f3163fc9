"""A recording cut at every byte: it opens, at most a second is lost, the loss is stated, and it can be closed again."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader

from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingFailed, RecordingSettings
from afdsvc.files.recording.recover import recover_in_place
from afdsvc.service.housekeeping import Keep, tidy
from afdsvc.wire.codec import encode_block


@pytest.fixture
def timed(tmp_path, blocks):
    """A recording of 20 blocks of 50 ms, written as they come, and the bytes on disk at each moment [s]."""
    now = [0.0]
    recorder = Recorder(RecordingSettings(tmp_path / "a.mcap", preview_hertz=0.0), Header("site"), lambda: now[0])
    sizes = []
    for block in blocks(20):
        now[0] += 0.05
        recorder.block(encode_block(block), block)
        sizes.append((os.path.getsize(recorder.path), now[0]))
    yield recorder, sizes
    recorder.close()


def test_wherever_the_power_fails_less_than_a_second_is_lost(timed, tmp_path):
    """Every prefix of the file, as the disk may hold it when the power fails: over 500 of them, byte by byte."""
    recorder, sizes = timed
    raw, cut, points = recorder.path.read_bytes(), tmp_path / "cut.mcap", 0
    for length in [*range(8, sizes[-1][0], 41), *(size + d for size, _ in sizes for d in (-2, -1, 0, 1))]:
        cut.write_bytes(raw[:length])
        recording = Recording(cut)
        kept = [b.seq for b in recording.blocks()]
        failed_at = max((t for size, t in sizes if size <= length), default=0.0)
        assert kept == list(range(len(kept)))
        assert failed_at - 0.05 * len(kept) < 1.0
        assert "the file was not closed" in recording.loss
        points += 1
    assert points > 500


@pytest.mark.long
def test_wherever_the_power_fails_byte_by_byte(timed, tmp_path):
    recorder, sizes = timed
    raw, cut = recorder.path.read_bytes(), tmp_path / "cut.mcap"
    for length in range(8, len(raw)):
        cut.write_bytes(raw[:length])
        kept = [b.seq for b in Recording(cut).blocks()]
        assert max((t for size, t in sizes if size <= length), default=0.0) - 0.05 * len(kept) < 1.0


def test_what_is_flushed_is_on_the_disk_itself(tmp_path, blocks, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    now = [0.0]
    recorder = Recorder(RecordingSettings(tmp_path / "a.mcap"), monotonic=lambda: now[0])
    begun = len(synced)
    for block in blocks(20):
        now[0] += 0.05
        recorder.block(encode_block(block), block)
    assert len(synced) - begun == 2
    recorder.close()


def test_a_torn_recording_is_closed_and_indexed_under_its_name(timed):
    recorder, sizes = timed
    path, raw = recorder.path, recorder.path.read_bytes()
    recorder._file.abandon()
    recorder._file = None
    path.write_bytes(raw[: sizes[-1][0] - 3])
    before = [b.seq for b in Recording(path).blocks()]
    done = recover_in_place(path)
    after = Recording(path)
    assert [b.seq for b in after.blocks()] == before
    assert is_finished(path)
    assert "was not closed" in done.loss
    assert "was not closed" in after.metadata["recovered"]["loss"]
    assert sorted(os.listdir(path.parent)) == [path.name]
    with path.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == len(before)


def test_the_original_stays_where_its_middle_is_damaged(timed):
    recorder, _ = timed
    recorder.close()
    raw = bytearray(recorder.path.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    recorder.path.write_bytes(raw)
    assert "damaged" in recover_in_place(recorder.path).loss
    assert recorder.path.with_name("a.mcap.damaged").read_bytes() == bytes(raw)


def test_what_a_running_process_writes_is_left_alone(timed):
    recorder, _ = timed
    with pytest.raises(BadInput, match="is being written by a running process"):
        recover_in_place(recorder.path)
    recorder.close()
    recover_in_place(recorder.path)


@pytest.mark.parametrize("content", [b"", b"not an mcap file at all"])
def test_what_is_no_recording_is_not_touched(tmp_path, content):
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(BadInput):
        recover_in_place(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == content


def test_a_small_disk_that_is_full_is_reported_and_what_was_written_opens(tmp_path, blocks):
    """A file system of 100 kB where this may be mounted, a limit on the size of files otherwise."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = os.geteuid() == 0 and os.system(f"mount -t tmpfs -o size=100k none {place} 2>/dev/null") == 0
    if not mounted:
        pytest.skip("no right to mount a small disk here")
    try:
        now, written = [0.0], []
        recorder = Recorder(RecordingSettings(place / "a.mcap"), monotonic=lambda: now[0])

        def write_all():
            for block in blocks(200):
                now[0] += 0.05
                recorder.block(encode_block(block), block)
                written.append(block.seq)

        with pytest.raises(RecordingFailed, match="No space left on device"):
            write_all()
        kept = [b.seq for b in Recording(recorder.path).blocks()]
        assert kept == list(range(len(kept)))
        assert 0.05 * (len(written) - len(kept)) < 1.0
        assert recorder.dropped == len(written) + 1 - len(kept)
    finally:
        os.system(f"umount {place}")


def test_a_folder_that_may_only_be_read_is_named(tmp_path):
    folder = tmp_path / "r"
    folder.mkdir(mode=0o500)
    if os.access(folder, os.W_OK) and os.system(f"mount -t tmpfs -o ro none {folder} 2>/dev/null") != 0:
        pytest.skip("this user may write everywhere")
    try:
        with pytest.raises(RecordingFailed, match=r"a\.mcap: cannot be written: (Read-only file system|Permission denied)"):
            Recorder(RecordingSettings(folder / "a.mcap"))
    finally:
        os.system(f"umount {folder} 2>/dev/null")


def recording_file(folder: Path, name: str, size: int, age_days: float, now: float) -> Path:
    path = folder / name
    path.write_bytes(bytes(size))
    os.utime(path, (now - 86400 * age_days,) * 2)
    return path


def test_the_oldest_recordings_go_first_and_never_the_one_being_written(tmp_path):
    now = 1_800_000_000.0
    busy = recording_file(tmp_path, "m1-20261101T120000.mcap", 1000, 40, now)
    old = recording_file(tmp_path, "m1-20261102T120000.0001.mcap", 1000, 30, now)
    review = recording_file(tmp_path, "m2-20261103T120000.rrd", 1000, 20, now)
    young = recording_file(tmp_path, "m2-20261104T120000-2.mcap", 1000, 1, now)
    others = [recording_file(tmp_path, name, 10**6, 99, now) for name in ("notes.txt", "measured.mcap", "site-alarms.sqlite")]
    assert tidy(tmp_path, Keep(), [busy], now) == []
    removed = tidy(tmp_path, Keep(seconds=25 * 86400), [busy], now)
    assert [r.path for r in removed] == [old]
    assert "is 30.0 days old, more than the 25 days that are kept" in removed[0].why
    removed = tidy(tmp_path, Keep(bytes=2500), [busy], now)
    assert [r.path for r in removed] == [review]
    assert "is the oldest of 0.0 MB" in removed[0].why
    assert busy.exists()
    assert young.exists()
    assert all(path.exists() for path in others)
    assert tidy(tmp_path / "none", Keep(bytes=1), [], now) == []


def test_locks_are_those_of_the_operating_system(tmp_path):
    """The claim ends with the process, however it dies: it is the kernel's lock, not a file that stays behind."""
    recorder = Recorder(RecordingSettings(tmp_path / "a.mcap"))
    with recorder.path.open("rb") as file, pytest.raises(BlockingIOError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    recorder._file.abandon()
    with recorder.path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
