"""The history of severities comes from the decisions of many recordings, whatever order they are given in."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from afdsvc.api.evidence import Severity
from afdsvc.errors import BadInput
from afdsvc.files.recording.reader import messages_on
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.present.rerun.history import review_history, severities
from afdsvc.wire.codec import encode, encode_block

DAY = 86400 * 10**9


@pytest.fixture
def months(tmp_path, blocks, finding):
    """Thirty recordings, one a day, a fault that grows by a hundredth a day from the tenth on."""
    made = []
    for day in range(30):
        recorder = Recorder(RecordingSettings(tmp_path / f"d{day}.mcap"))
        for block in blocks(4):
            moved = replace(block, t0_ns=block.t0_ns + day * DAY)
            recorder.block(encode_block(moved), moved)
        grown = {"severity": Severity(-0.01 * (day - 9), 0.002)} if day >= 10 else {}
        f = finding(0.1, 41.0 if day >= 10 else 3.0, burst=f"b{day}", **grown)
        f = replace(f, t_ns=f.t_ns + day * DAY)
        recorder.finding(encode(f), f)
        recorder.close()
        made.append(recorder.path)
    return made


def test_every_burst_is_a_point_in_order_of_time(months):
    rows = severities(reversed(months))["m1"]
    assert [name for _, name, *_ in rows] == [""] * 10 + ["sensor"] * 20
    assert [round(value, 6) for _, _, value, _ in rows[10:]] == [round(-0.01 * n, 6) for n in range(1, 21)]
    assert all(b[0] - a[0] == DAY for a, b in pairwise(rows))


def test_it_is_drawn_in_per_cent_with_two_standard_errors(months, tmp_path, rrd):
    file = rrd(review_history(months, tmp_path / "h.rrd"))
    last = {kind: file.rows(f"/m1/history/sensor{kind}")[-1][1] for kind in ("", "_low", "_high")}
    assert last == {"": pytest.approx(-20.0), "_low": pytest.approx(-20.4), "_high": pytest.approx(-19.6)}
    assert [v for _, v in file.rows("/m1/history/_nothing")] == [0.0] * 10


def test_a_recording_whose_writer_died_is_read_through(months, tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(months[20].read_bytes()[:-300])
    assert len(list(messages_on(torn, "evidence"))) == len(list(messages_on(months[20], "evidence"))) == 1


def test_recordings_without_decisions_are_refused_in_words(tmp_path, blocks):
    recorder = Recorder(RecordingSettings(tmp_path / "q.mcap"))
    for block in blocks(2):
        recorder.block(encode_block(block), block)
    recorder.close()
    with pytest.raises(BadInput, match=r"1 recording\(s\) hold no decision on any burst"):
        review_history([recorder.path], tmp_path / "h.rrd")
