"""Reading recordings whole, unfinished, cut at any byte, damaged, foreign: what is complete comes, losses are reported."""

import hashlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from afdsvc.errors import BadInput
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recover import recover
from afdsvc.wire.codec import encode_block


def test_a_whole_recording_has_no_loss_and_everything_in_it(record, blocks, an_event, a_finding):
    recording = Recording(record(count=12))
    assert (recording.loss, recording.contents.finished, recording.machines) == ("", True, ("m1",))
    assert recording.site == "[site]\nname='plant'"
    assert list(recording.events()) == [an_event()]
    assert list(recording.findings("m1")) == [a_finding()]
    assert [b.values.tobytes() for b in recording.blocks()] == [b.values.tobytes() for b in blocks(12)]
    assert recording.counts["/m1/block"] == 12
    assert list(recording.blocks("m2")) == []


def test_one_still_being_written_is_read_and_said_to_be_open(record):
    recording = Recording(record(count=12, close=False, flush_each=True))
    assert len(list(recording.blocks())) == 12
    assert "was not closed" in recording.loss
    assert "no complete record" not in recording.loss


def test_wherever_it_is_cut_all_that_is_complete_is_there(record, tmp_path):
    raw = record(count=3, flush_each=True, preview_hertz=10.0).read_bytes()
    cut, kept = tmp_path / "cut.mcap", []
    for length in cuts(raw):
        cut.write_bytes(raw[:length])
        recording = Recording(cut)
        assert not recording.contents.finished
        assert "was not closed" in recording.loss
        kept.append([b.seq for b in recording.blocks()])
    assert all(seqs == list(range(len(seqs))) for seqs in kept)
    assert [len(seqs) for seqs in kept] == sorted(len(seqs) for seqs in kept)
    assert (len(kept[0]), len(kept[-1])) == (0, 3)


def cuts(raw: bytes) -> list[int]:
    """Return the lengths around every record's edges and every 29th in between."""
    edges = [edge for place in chunk_places(raw) for edge in place]
    around = {edge + offset for edge in edges for offset in range(-10, 11)} | set(range(len(raw) - 40, len(raw)))
    return sorted(around | set(range(8, len(raw), 29)))


def test_what_is_torn_off_is_stated(record, tmp_path):
    raw = record(count=5, close=False, flush_each=True).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(raw[:-3])
    recording = Recording(tmp_path / "cut.mcap")
    assert len(list(recording.blocks())) == 5 or "no complete record" in recording.loss
    assert f"from byte {len(raw) - 3 - recording_tail(recording)}" in recording.loss


def recording_tail(recording):
    return int(recording.contents.losses[0].sentence.split()[2])


def test_zeros_at_the_end_are_a_torn_file(record, tmp_path):
    raw = record(count=5, close=False, flush_each=True).read_bytes()
    (tmp_path / "zeros.mcap").write_bytes(raw + bytes(4096))
    recording = Recording(tmp_path / "zeros.mcap")
    assert len(list(recording.blocks())) == 5
    assert f"the last 4096 bytes, from byte {len(raw)}" in recording.loss


def chunk_places(raw: bytes) -> list[tuple[int, int]]:
    """Return start and end of the content of every chunk."""
    at, found = 8, []
    while raw[at] != 0x0F:
        length = int.from_bytes(raw[at + 1 : at + 9], "little")
        if raw[at] == 6:
            found.append((at + 9, at + 9 + length))
        at += 9 + length
    return found


@pytest.mark.parametrize("chunk", [0, 2, 4])
def test_a_damaged_chunk_costs_itself_and_nothing_else(record, chunk):
    path = record(count=5, flush_each=True)
    raw = bytearray(path.read_bytes())
    start, end = chunk_places(raw)[chunk]
    raw[(start + end) // 2] ^= 0xFF
    path.write_bytes(raw)
    recording = Recording(path)
    assert [b.seq for b in recording.blocks()] == [seq for seq in range(5) if seq != chunk]
    assert "chunk" in recording.loss
    assert "0.000 s of data) is damaged" in recording.loss or "s of data is damaged" in recording.loss
    assert recording.contents.losses[0].start_ns > 0


def test_a_damaged_attachment_is_reported_and_left_out(record):
    path = record(count=2)
    raw = path.read_bytes()
    path.write_bytes(raw.replace(b"model text", b"modeL text"))
    recording = Recording(path)
    assert "m1/model.toml" not in recording.attachments
    assert "attachment 'm1/model.toml' is damaged" in recording.loss
    assert len(list(recording.blocks())) == 2


@settings(deadline=None, max_examples=120)
@given(st.data())
def test_any_damage_is_read_or_named(record_once, data):
    path, whole = record_once
    raw = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    try:
        recording = Recording(path)
    except BadInput as error:
        assert str(path) in str(error)  # noqa: PT017 - the damage may leave nothing of the file
        return
    good = {encode_block(b) for b in whole_blocks(path, whole)}
    assert all(encode_block(b) in good for b in recording.blocks())
    list(recording.events()), list(recording.findings())


@pytest.fixture(scope="module")
def record_once(tmp_path_factory):
    from afdsvc.files.recording.recorder import Recorder, RecordingSettings

    folder = tmp_path_factory.mktemp("damage")
    recorder = Recorder(RecordingSettings(folder / "whole.mcap", preview_hertz=0.0))
    for seq, values in enumerate(([[1.0]], [[2.0]], [[3.0]])):
        block = simple_block(seq, values)
        recorder.block(encode_block(block), block)
        recorder.flush()
    recorder.close()
    return folder / "damaged.mcap", recorder.path.read_bytes()


def simple_block(seq, values):
    import numpy as np

    from afdsvc.api.signals import Block, Channel

    return Block("m1", "s1", seq, seq, 0.1, 10**18, (Channel("u_x"),), np.array(values))


_BLOCKS: dict[bytes, list] = {}


def whole_blocks(path, whole):
    key = hashlib.sha256(whole).digest()
    if key not in _BLOCKS:
        clean = path.with_name("clean.mcap")
        clean.write_bytes(whole)
        _BLOCKS[key] = list(Recording(clean).blocks())
    return _BLOCKS[key]


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"", "is empty"),
        (b"t,u_a\n0,1\n", "is not an MCAP file: it begins with b't,u_a"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "Git LFS pointer"),
        (b"\x89MCAP1\r\n", "is not an MCAP file"),
    ],
)
def test_files_that_are_something_else_are_named(tmp_path, raw, words):
    (tmp_path / "a.mcap").write_bytes(raw)
    with pytest.raises(BadInput, match=words) as error:
        Recording(tmp_path / "a.mcap")
    assert str(tmp_path / "a.mcap") in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(BadInput, match="No such file"):
        Recording(tmp_path / "none.mcap")


def test_a_foreign_recording_is_named_with_what_it_holds(tmp_path):
    with (tmp_path / "foreign.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start()
        channel = writer.register_channel("/camera", "json", writer.register_schema("Image", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    recording = Recording(tmp_path / "foreign.mcap")
    assert recording.machines == ()
    with pytest.raises(BadInput, match=r"holds no samples.*it has /camera"):
        recording.traces()


def test_a_block_nobody_can_decode_is_reported_and_passed_over(tmp_path, blocks):
    from afdsvc.files.recording.mcap_file import Header, McapFile

    file = McapFile(tmp_path / "r.mcap", Header())
    for seq, data in enumerate([encode_block(blocks(1)[0]), b"\xff\xff", b""]):
        file.wire("/m1/block", "Block", 1000 + seq, data)
    file.finish()
    recording = Recording(tmp_path / "r.mcap")
    for _ in range(2):
        assert len(list(recording.blocks())) == 1
        assert recording.loss.count("a message of /m1/block") == 2


def test_a_model_inside_is_read_and_named_by_its_place(tmp_path, record):
    recording = Recording(record(count=1))
    with pytest.raises(BadInput, match=r"run\.mcap:m1/model\.toml: not a TOML file"):
        recording.model("m1")
    assert recording.model("m2") is None


def test_recovered_it_opens_everywhere_and_holds_the_same(record, tmp_path):
    raw = record(count=8, flush_each=True, close=False).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(raw[:-700])
    torn = Recording(tmp_path / "cut.mcap")
    kept = [encode_block(b) for b in torn.blocks()]
    saved = recover(tmp_path / "cut.mcap", tmp_path / "new.mcap")
    again = Recording(tmp_path / "new.mcap")
    assert 0 < len(kept) == saved.messages["/m1/block"]
    assert "no complete record" in saved.loss
    assert again.loss == ""
    assert [encode_block(b) for b in again.blocks()] == kept
    assert again.attachments == torn.attachments
    assert again.metadata["afdsvc"] == torn.metadata["afdsvc"]
    assert again.metadata["recovered"]["loss"] == saved.loss
    from mcap.reader import make_reader

    with (tmp_path / "new.mcap").open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary().statistics.message_count == again.counts.total()


def test_recovery_overwrites_nothing(record):
    path = record(count=1)
    with pytest.raises(BadInput, match="exists already"):
        recover(path, path)
