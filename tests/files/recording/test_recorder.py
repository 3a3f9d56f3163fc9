"""The recorder: the very wire bytes, self-contained, flushed, rotated, and loud when it cannot write."""

import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from afdsvc import __version__
from afdsvc.api.bursts import Burst, Line
from afdsvc.files.recording.foxglove import Level
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingFailed, RecordingSettings
from afdsvc.wire.codec import encode, encode_block
from afdsvc.wire.messages import BurstRequest, RigDescription


class Clock:
    """Seconds that pass when ordered to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def messages(path, topic):
    with open(path, "rb") as file:
        return [m.data for _, _, m in make_reader(file).iter_messages(topics=[topic])]


def test_the_very_bytes_are_in_the_file(record, blocks, an_event, a_finding):
    path = record(count=12)
    assert messages(path, "/m1/block") == [encode_block(b) for b in blocks(12)]
    assert messages(path, "/m1/event") == [encode(an_event())]
    assert messages(path, "/m1/evidence") == [encode(a_finding())]


def test_the_file_explains_itself_from_its_first_bytes(record):
    path = record(count=1)
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "afdsvc"
        facts = {m.name: m.metadata for m in reader.iter_metadata()}["afdsvc"]
        attached = {a.name: a.data for a in reader.iter_attachments()}
        first_chunk = reader.get_summary().chunk_indexes[0].chunk_start_offset
        indexed = [*reader.get_summary().attachment_indexes, *reader.get_summary().metadata_indexes]
    assert facts == {"version": __version__, "part": "0", "site": "plant"}
    assert attached == {"site.toml": b"[site]\nname='plant'", "m1/model.toml": b"model text"}
    assert all(i.offset < first_chunk for i in indexed)


def test_plain_viewers_decode_everything_without_our_code(record):
    with record(count=12).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages()]
    kinds = {topic: type(m).DESCRIPTOR.full_name for topic, m in decoded}
    assert kinds == {
        "/m1/block": "afdsvc.v1.Block",
        "/m1/preview": "afdsvc.preview1.Sample",
        "/m1/event": "afdsvc.v1.RigEvent",
        "/m1/log": "foxglove.Log",
        "/m1/evidence": "afdsvc.v1.Evidence",
    }
    block = next(m for topic, m in decoded if topic == "/m1/block")
    assert [s.name for s in block.signals] == ["u_x", "y_x", "alpha_x", "beta_x"]


def test_the_log_tells_bursts_and_what_is_found(record):
    with record(count=12).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        reported = [(m.level, m.message, m.name) for _, c, _, m in reader.iter_decoded_messages(topics=["/m1/log"])]
    assert reported == [
        (Level.INFO, "burst 'b1' started: asked for by the scheduler", "m1"),
        (
            Level.ERROR,
            "matched_filter on x detects horizontal_actuator, severity -0.5 +- 0.02 (statistic 41.7, threshold 9.2)",
            "m1",
        ),
    ]


def test_the_same_verdict_is_reported_once(tmp_path, a_finding):
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap"))
    for k, detected in enumerate([False, False, True, True, False, True]):
        finding = a_finding(100 + k, detected)
        recorder.finding(encode(finding), finding)
    recorder.close()
    assert len(messages(recorder.path, "/m1/evidence")) == 6
    assert len(messages(recorder.path, "/m1/log")) == 3


@pytest.mark.parametrize(("hertz", "expected"), [(100.0, 60), (1000.0, 600), (5000.0, 600), (100 / 3, 20), (0.0, 0)])
def test_the_preview_shows_whole_samples_at_its_rate(record, blocks, hertz, expected):
    path = record(count=12, preview_hertz=hertz)
    stride = 600 // expected if expected else 0
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        shown = [m for *_, m in reader.iter_decoded_messages(topics=["/m1/preview"])]
    assert [m.k for m in shown] == list(range(0, 600, stride) if expected else [])
    for m in shown:
        block = blocks(12)[m.k // 50]
        assert [m.u_x, m.y_x, m.alpha_x, m.beta_x] == block.values[m.k % 50].tolist()
        assert m.timestamp.ToNanoseconds() == block.t0_ns + round((m.k % 50) * block.dt * 1e9)


def test_what_is_said_of_rig_bursts_and_notes_is_kept(tmp_path, blocks):
    block = blocks(1)[0]
    described = RigDescription("m1", "s1", block.t0_ns, block.dt, block.channels, controller="proportional")
    asked = BurstRequest("m1", Burst("b1", 1, 10, 2, (Line(0, 6.0, 0.1),)), 2.0, "kim", block.t0_ns)
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap"))
    recorder.description(encode(described), described)
    recorder.request(encode(asked), asked)
    recorder.residual(encode_block(block), block)
    recorder.note(block.t0_ns, Level.WARNING, "quiet hours begin", "m1")
    recorder.close()
    recording = Recording(recorder.path)
    assert [d.controller for d in recording.descriptions("m1")] == ["proportional"]
    assert [r.burst.lines for r in recording.requests("m1")] == [asked.burst.lines]
    assert [b.values.tobytes() for b in recording.residuals("m1")] == [block.values.tobytes()]
    assert recording.counts["/m1/log"] == 1


def test_rotation_by_size_loses_nothing_and_every_part_stands_alone(tmp_path, blocks):
    block = blocks(1)[0]
    described = RigDescription("m1", "s1", block.t0_ns, block.dt, block.channels)
    recorder = Recorder(
        RecordingSettings(tmp_path / "r.mcap", max_bytes=15_000, flush_seconds=0.0), Header("site", {"m1": "model"})
    )
    recorder.description(encode(described), described)
    recorder.attach("late.txt", "text/plain", b"late")
    for b in blocks(40):
        recorder.block(encode_block(b), b)
    recorder.close()
    assert [p.name for p in recorder.paths[:3]] == ["r.mcap", "r.0001.mcap", "r.0002.mcap"]
    assert sorted(os.listdir(tmp_path)) == sorted(p.name for p in recorder.paths)
    parts = [Recording(p) for p in recorder.paths]
    assert [b.seq for part in parts for b in part.blocks()] == list(range(40))
    assert all(part.loss == "" for part in parts)
    for number, part in enumerate(parts):
        assert set(part.attachments) == {"site.toml", "m1/model.toml", "late.txt"}
        assert part.metadata["afdsvc"]["part"] == str(number)
        assert len(list(part.descriptions())) == 1
    assert recorder.bytes_written == sum(p.stat().st_size for p in recorder.paths)


def test_rotation_by_time(tmp_path, blocks):
    clock = Clock()
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap", max_seconds=60.0), monotonic=clock)
    for b in blocks(10):
        recorder.block(encode_block(b), b)
        clock.now += 20.0
    recorder.close()
    assert [len(list(Recording(p).blocks())) for p in recorder.paths] == [3, 3, 3, 1]


def test_flushed_twice_a_second_by_writing_or_by_ticks(tmp_path, blocks):
    clock = Clock()
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap"), monotonic=clock)
    first, second, third = blocks(3)
    recorder.block(encode_block(first), first)
    assert len(list(Recording(recorder.path).blocks())) == 0
    clock.now = 0.41
    recorder.block(encode_block(second), second)
    assert len(list(Recording(recorder.path).blocks())) == 2
    recorder.block(encode_block(third), third)
    recorder.tick()
    assert len(list(Recording(recorder.path).blocks())) == 2
    clock.now = 0.82
    recorder.tick()
    assert len(list(Recording(recorder.path).blocks())) == 3
    recorder.close()


def test_an_existing_recording_is_not_overwritten_unasked(record):
    path = record(count=3)
    with pytest.raises(RecordingFailed, match=r"run\.mcap: cannot be written: it exists already"):
        record(count=1)
    assert len(list(Recording(path).blocks())) == 3
    assert len(list(Recording(record(count=1, overwrite=True)).blocks())) == 1


@pytest.mark.parametrize("place", ["file/inside.mcap", "/proc/nothing/run.mcap", "."])
def test_a_place_that_cannot_be_written_is_named(tmp_path, place):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingFailed, match="cannot be written") as error:
        Recorder(RecordingSettings(tmp_path / place))
    assert str(tmp_path / place) in str(error.value)


def test_a_full_disk_is_reported_at_once(tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    (tmp_path / "run.mcap").symlink_to("/dev/full")
    with pytest.raises(RecordingFailed, match="No space left on device"):
        Recorder(RecordingSettings(tmp_path / "run.mcap", overwrite=True))
    assert os.listdir(tmp_path) == []


# In a process of its own: the limit on file sizes cannot be taken back.
FULL = """
import resource, signal, sys
from pathlib import Path
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingFailed, RecordingSettings
from afdsvc.wire.codec import encode_block
sys.path.insert(0, sys.argv[1])
from conftest import machine_blocks
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
folder, now = Path(sys.argv[2]), [0.0]
recorder = Recorder(RecordingSettings(folder / "r.mcap", flush_seconds=0.0), monotonic=lambda: now[0])
blocks = machine_blocks(60)
lost = []
for b in blocks[:50]:
    if b.seq == 20:
        resource.setrlimit(resource.RLIMIT_FSIZE, (recorder.bytes_written + 3000, resource.RLIM_INFINITY))
    try:
        recorder.block(encode_block(b), b)
    except RecordingFailed as error:
        lost.append(b.seq)
        assert "r.mcap: cannot be written: File too large" in str(error), error
assert lost and lost == list(range(lost[0], 50)), lost
assert recorder.failure and recorder.dropped == len(lost), (recorder.dropped, len(lost))
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
now[0] = 11.0
for b in blocks[50:]:
    recorder.block(encode_block(b), b)
assert recorder.failure == ""
recorder.close()
torn, whole = (Recording(p) for p in recorder.paths)
kept = [b.seq for b in torn.blocks()]
assert kept == list(range(lost[0])) and "no complete record" in torn.loss and not torn.contents.finished, (kept, torn.loss)
assert [b.seq for b in whole.blocks()] == list(range(50, 60)) and whole.loss == ""
assert whole.metadata["gap"]["messages"] == str(len(lost)), whole.metadata
print("went on")
"""


def test_a_disk_that_fills_up_is_reported_counted_and_survived(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(Path(__file__).parents[1]), str(tmp_path)], capture_output=True, text=True
    )
    assert done.stdout == "went on\n", done.stderr
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_after_a_failure_a_new_file_is_tried_but_not_all_the_time(tmp_path, blocks, monkeypatch):
    clock, tried = Clock(), []
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap"), monotonic=clock)
    recorder.close()
    recorder.failure = "disk full"

    def opened(path):
        tried.append(path.name)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder, "_open", opened)
    for clock.now in (1.0, 5.0, 10.0, 11.0, 21.0):
        with pytest.raises(RecordingFailed):
            recorder.block(b"", blocks(1)[0])
    assert len(tried) == 2
    assert recorder.dropped == 5


def test_a_file_that_cannot_be_begun_when_it_is_time_for_it_is_tried_again(tmp_path, blocks):
    """Found by reading: the recorder had closed the last file, failed over its path, and recorded nothing any more."""
    clock = Clock()
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap", max_seconds=5.0), monotonic=clock)
    first, second, third = blocks(3)
    recorder.block(encode_block(first), first)
    (tmp_path / "r.0001.mcap").symlink_to("nowhere/r.mcap")  # a file that does not exist and cannot be made
    clock.now = 6.0
    with pytest.raises(RecordingFailed, match=r"r\.0001\.mcap: cannot be written"):
        recorder.block(encode_block(second), second)
    (tmp_path / "r.0001.mcap").unlink()
    clock.now = 17.0
    recorder.block(encode_block(third), third)
    recorder.close()
    assert [[b.seq for b in Recording(p).blocks()] for p in recorder.paths] == [[0], [2]]
    assert (recorder.dropped, recorder.torn, recorder.writing) == (1, [], [])


def test_a_closed_recorder_says_so(tmp_path, blocks):
    recorder = Recorder(RecordingSettings(tmp_path / "r.mcap"))
    recorder.close()
    recorder.close()
    with pytest.raises(RecordingFailed, match="is closed"):
        recorder.block(encode_block(blocks(1)[0]), blocks(1)[0])


KILLED = """
import sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from conftest import machine_blocks
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.wire.codec import encode_block
recorder = Recorder(RecordingSettings(Path(sys.argv[2])), Header("the site", {"m1": "the model"}))
for b in machine_blocks(10_000):
    recorder.block(encode_block(b), b)
    print(b.seq, flush=True)
    time.sleep(0.01)
"""


def test_killed_while_recording_loses_less_than_half_a_second(tmp_path):
    path = tmp_path / "killed.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(Path(__file__).parents[1]), str(path)], stdout=subprocess.PIPE, text=True
    )
    written = []
    for line in child.stdout:
        written.append(int(line))
        if written[-1] == 150:
            break
    child.send_signal(signal.SIGKILL)
    written += [int(line) for line in child.stdout]
    child.wait()
    child.stdout.close()
    recording = Recording(path)
    kept = [b.seq for b in recording.blocks()]
    assert kept == list(range(len(kept)))
    assert len(written) - len(kept) < 50  # every one takes 10 ms or more
    assert "was not closed" in recording.loss
    assert recording.site == "the site"
    assert recording.attachments["m1/model.toml"] == b"the model"


@pytest.mark.parametrize("how", ["deleted", "moved", "replaced", "folder deleted", "cut short"])
def test_a_recording_that_is_deleted_is_noticed_and_a_new_one_begun(tmp_path, blocks, how):
    recorder, (first, *rest) = Recorder(RecordingSettings(tmp_path / "in" / "r.mcap", flush_seconds=0.0)), blocks(6)
    recorder.block(encode_block(first), first)
    lost = recorder.path
    if how == "moved":
        lost.rename(tmp_path / "elsewhere.mcap")
    elif how == "cut short":
        os.truncate(lost, 100)
    elif how == "folder deleted":
        shutil.rmtree(lost.parent)
    else:
        lost.unlink()
    if how == "replaced":
        lost.write_text("something else")
    with pytest.raises(RecordingFailed, match=r"r.mcap: cannot be written: the file was deleted, moved, replaced or cut short"):
        recorder.block(encode_block(rest[0]), rest[0])
    assert lost not in recorder.paths
    for block in rest[1:]:
        recorder.block(encode_block(block), block)
    recorder.close()
    assert [b.seq for b in Recording(recorder.path).blocks()] == [2, 3, 4, 5]
    assert Recording(recorder.path).metadata["gap"]["messages"] == "2"
    assert recorder.dropped == 2
