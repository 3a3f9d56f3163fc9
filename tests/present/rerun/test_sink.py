"""The sink of the runtime: everything about any number of machines, in files of bounded length."""

from afdsvc.api.signals import residual_block
from afdsvc.present.rerun.log import ReviewSink
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import EventKind, Notice, Residual, RigEvent


def test_everything_a_runtime_says_is_shown(tmp_path, blocks, finding, rrd):
    sink = ReviewSink(tmp_path / "a.rrd")
    for machine in ("m1", "m2"):
        block = blocks(1, machine=machine)[0]
        sink.take(Message(block, b""))
        sink.take(Message(Residual(residual_block(block, block.values[:, 2:4]))))
    sink.take(Message(finding(1.0, 41.0)))
    sink.take(Message(RigEvent("m2", "s1", block.t0_ns, EventKind.RIG_STOPPED), b""))
    sink.take(Message(Notice("m1", "warning", "quiet hours", block.t0_ns)))
    sink.tick()
    sink.close()
    sink.close()
    file = rrd(tmp_path / "a.rrd")
    rows = file.rows("/m2/signals/whitened/r_h")
    assert {v for _, v in rows} <= set(block.column("y_h"))
    assert [v for _, v in file.rows("/m2/log", "TextLog:text")] == ["rig stopped"]
    assert "quiet hours" in [v for _, v in file.rows("/m1/log", "TextLog:text")]
    assert file.rows("/m1/decisions/matched_filter/all\\ outputs/alarm") == [(10**9, 41.0)]


def test_files_are_bounded_and_never_change_inside_a_burst(tmp_path, blocks, rrd):
    sink = ReviewSink(tmp_path / "a.rrd", max_seconds=0.2)
    sink.take(Message(RigEvent("m1", "s1", blocks(1)[0].t0_ns, EventKind.RIG_STARTED), b""))
    for block in blocks(12, bursts=(4, 5)):
        sink.take(Message(block, b""))
    sink.close()
    assert [p.name for p in sink.paths] == ["a.rrd", "a.0001.rrd", "a.0002.rrd"]
    lengths = [rrd(p).rows("/m1/signals/outputs/y_h")[-1][0] // 1_000_000 for p in sink.paths]
    assert [length // 50 for length in lengths] == [5, 3, 1]


def test_nothing_said_leaves_no_file(tmp_path):
    ReviewSink(tmp_path / "a.rrd").close()
    assert list(tmp_path.iterdir()) == []
