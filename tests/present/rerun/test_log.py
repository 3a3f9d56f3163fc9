"""What is logged stands in the file: samples, gaps, bursts, statistics, verdicts, sentences; and loopback only."""

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.error_utils import RerunWarning

from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.files.recording.foxglove import Level
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.blueprint import blueprint
from afdsvc.present.rerun.log import ReviewLog
from afdsvc.wire.messages import EventKind, RigEvent


def values(rows):
    return np.array([v for _, v in rows])


def test_samples_of_a_burst_are_all_there_to_the_last_bit(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    found = blocks(8, bursts=(3,))
    for block in found:
        log.block(block)
    log.close()
    rows = rrd(tmp_path / "a.rrd").rows("/m1/signals/outputs/y_h")
    during = [(t, v) for t, v in rows if 150_000_000 <= t < 200_000_000]
    assert values(during).tobytes() == found[3].column("y_h").tobytes()
    assert [t for t, _ in during] == [150_000_000 + k * 1_000_000 for k in range(50)]


def test_quiet_stretches_are_thinned_but_keep_their_extremes(tmp_path, blocks, rrd):
    found = blocks(8)
    for name, hertz in (("thin", 100.0), ("all", 0.0)):
        log = ReviewLog(tmp_path / f"{name}.rrd", quiet_hertz=hertz)
        for block in found:
            log.block(block)
        log.close()
    thin = rrd(tmp_path / "thin.rrd").rows("/m1/signals/residual/beta_v")
    every = rrd(tmp_path / "all.rrd").rows("/m1/signals/residual/beta_v")
    beta = np.concatenate([b.column("beta_v") for b in found])
    assert values(every).tobytes() == beta.tobytes()
    assert len(thin) < len(every) / 3
    assert (values(thin).min(), values(thin).max()) == (beta.min(), beta.max())


def test_lines_break_where_samples_are_missing(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    for block in (b for b in blocks(8) if b.seq not in (3, 4)):
        log.block(block)
    log.close()
    rows = rrd(tmp_path / "a.rrd").rows("/m1/signals/inputs/u_h")
    assert [t for t, v in rows if np.isnan(v)] == [250_000_000 - 1]


def test_bursts_stand_in_their_lane_and_are_shaded_in_every_view(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    for block in blocks(10, bursts=(2, 3, 9)):
        log.block(block)
    log.close()
    file = rrd(tmp_path / "a.rrd")
    lane = file.rows("/m1/states/burst", "StateChange:state")
    ms = 1_000_000
    # Bursts 2 and 3 follow each other without rest: the first ends where the second begins.
    assert [(t // ms, v) for t, v in lane if v] == [(100, "burst"), (150, "burst"), (450, "burst")]
    assert {t // ms for t, v in lane if not v} == {150, 200, 500}
    for view in ("outputs", "inputs", "excitation", "residual"):
        shade = file.rows(f"/m1/signals/{view}/_burst")
        spans = [t for t, v in shade if not np.isnan(v)]
        assert (min(spans), max(spans)) == (100 * ms, 500 * ms)
        assert not any(200 * ms < t < 450 * ms for t in spans)


def test_a_burst_cut_off_by_a_gap_ends_with_its_last_sample(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    for block in (b for b in blocks(10, bursts=(2, 7)) if b.seq not in (3, 4, 5, 6)):
        log.block(replace(block, burst="b" if block.burst else ""))
    log.close()
    lane = rrd(tmp_path / "a.rrd").rows("/m1/states/burst", "StateChange:state")
    assert [(t // 1_000_000, bool(v)) for t, v in lane] == [(100, True), (150, False), (350, True), (400, False)]


def test_shading_reaches_what_the_view_will_span(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    log.span("m1", {"outputs": (-11.0, 12.0)})
    for block in blocks(3, bursts=(1,)):
        log.block(block)
    log.close()
    shade = values(rrd(tmp_path / "a.rrd").rows("/m1/signals/outputs/_burst"))
    assert (np.nanmin(shade), np.nanmax(shade)) == (-11.0, 12.0)


def test_statistic_threshold_and_verdict(tmp_path, blocks, finding, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    log.block(blocks(1)[0])
    log.finding(finding(1.0, 3.5, "h"))
    log.finding(finding(2.0, 41.0, "h"))
    log.finding(finding(3.0, 42.0, "h", trustworthy=False, reason="residual not white"))
    log.finding(finding(4.0, 43.0, "h", fault=None))
    log.close()
    file, s = rrd(tmp_path / "a.rrd"), 1_000_000_000
    root = "/m1/decisions/matched_filter/h"
    assert file.rows(root) == [(1 * s, 3.5), (2 * s, 41.0), (3 * s, 42.0), (4 * s, 43.0)]
    assert file.rows(f"{root}/threshold") == [(t * s, 9.0) for t in (0, 1, 2, 3, 4)]
    assert file.rows(f"{root}/quiet") == [(1 * s, 3.5)]
    assert file.rows(f"{root}/alarm") == [(2 * s, 41.0), (4 * s, 43.0)]
    assert file.rows(f"{root}/doubt") == [(3 * s, 42.0)]
    assert file.rows("/m1/states/matched_filter_h", "StateChange:state") == [
        (1 * s, "quiet"), (2 * s, "sensor"), (3 * s, "not trustworthy"), (4 * s, "detected, cause open"),
    ]  # fmt: skip
    known = file.static("/m1/states/matched_filter_h", "StateConfiguration:values")
    assert known == ["quiet", "sensor", "not trustworthy", "detected, cause open"]
    assert len(file.static("/m1/states/matched_filter_h", "StateConfiguration:colors")) == 4


def test_events_and_news_are_reported_once(tmp_path, blocks, finding, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    log.block(blocks(1)[0])
    log.event(RigEvent("m1", "s1", blocks(1)[0].t0_ns, EventKind.BURST_REFUSED, 0, "b1", "already playing"))
    log.event(RigEvent("m1", "s1", blocks(1)[0].t0_ns + 10**9, EventKind.FAULT_INJECTED, 0, "", "sensor -0.5"))
    for seconds in (2.0, 3.0):
        log.finding(finding(seconds, 41.0))
    log.note(blocks(1)[0].t0_ns + 4 * 10**9, Level.WARNING, "quiet hours", "m1")
    log.close()
    file = rrd(tmp_path / "a.rrd")
    reported = [(t // 10**9, v) for t, v in file.rows("/m1/log", "TextLog:text")]
    assert reported == [
        (0, "burst 'b1' refused: already playing"), (1, "simulated fault set in: sensor -0.5"),
        (2, "matched_filter detects sensor, severity -0.5 +- 0.1 (statistic 41, threshold 9)"), (4, "quiet hours"),
    ]  # fmt: skip
    assert [v for _, v in file.rows("/m1/log", "TextLog:level")] == ["WARN", "INFO", "ERROR", "WARN"]
    assert file.rows("/m1/states/simulated_fault", "StateChange:state") == [(10**9, "sensor -0.5")]


def test_the_whitened_residual_has_its_own_view(tmp_path, blocks, rrd):
    channels = (Channel("aux_r_h", "um"), Channel("aux_r_v", "um"))
    log = ReviewLog(tmp_path / "a.rrd")
    found = blocks(2, bursts=(0, 1), channels=channels)
    for block in found:
        log.residual(block)
    log.close()
    rows = rrd(tmp_path / "a.rrd").rows("/m1/signals/whitened/r_v")
    assert values(rows).tobytes() == np.concatenate([b.column("aux_r_v") for b in found]).tobytes()


def test_lines_never_average_and_carry_their_unit(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    log.block(blocks(1)[0])
    log.close()
    file = rrd(tmp_path / "a.rrd")
    entity = paths.signal("m1", "outputs", "y", "h")
    assert file.static(entity, "SeriesLines:names") == ["y h [um]"]
    min_max = 5
    assert file.static(entity, "SeriesLines:aggregation_policy") == [min_max]


def test_odd_ids_stay_one_part_of_the_path(tmp_path, blocks, rrd):
    log = ReviewLog(tmp_path / "a.rrd")
    log.block(blocks(1, machine="ø.1+2", channels=(Channel("y_gap (left)", "um"),))[0])
    log.close()
    [entity] = [e for e in rrd(tmp_path / "a.rrd").entities if "gap" in e]
    assert entity.count("/") == 4


def test_the_layout_is_inside_and_sent_again_only_when_it_changes(tmp_path, blocks, monkeypatch, rrd):
    log = ReviewLog(tmp_path / "a.rrd", batch_seconds=0.1)
    sent = []
    monkeypatch.setattr(
        "afdsvc.present.rerun.log.blueprint", lambda layouts, *rest, real=blueprint: sent.append(layouts) or real(layouts, *rest)
    )
    for block in blocks(12):
        log.block(block)
    log.close()
    assert len(sent) == 1
    kinds = [(entry.kind, entry.application_id) for entry in rrd(tmp_path / "a.rrd").reader.blueprints()]
    assert ("blueprint", "afdsvc") in kinds


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux to see who listens where")
def test_live_listens_on_loopback_only():
    port = free_port()
    log = ReviewLog(None, live=port)
    try:
        deadline = time.monotonic() + 10
        while not (listening := listeners(port)) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert listening == {"0100007F"}
        with pytest.raises(BadInput, match=f"port {port} of 127.0.0.1.*expected a free port"):
            ReviewLog(None, live=port)
    finally:
        log.close()


def listeners(port: int) -> set[str]:
    """Return the local addresses (hexadecimal, as Linux shows them) somebody of this port listens at."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:] if Path(table).exists() else ():
            address, state = line.split()[1], line.split()[3]
            if int(address.split(":")[1], 16) == port and state == "0A":
                found.add(address.split(":")[0])
    return found


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=r"file/a\.rrd: cannot be written"):
        ReviewLog(tmp_path / "file" / "a.rrd")


KILLED = """
import sys, time
import numpy as np
from pathlib import Path
from afdsvc.api.signals import Block, Channel
from afdsvc.present.rerun.log import ReviewLog
log = ReviewLog(Path(sys.argv[1]))
for seq in range(10_000):
    t_ns = 10**18 + seq * 50_000_000
    log.block(Block("m1", "s1", seq, seq * 50, 1e-3, t_ns, (Channel("y_x"),), np.ones((50, 1)), "b"))
    print(seq, flush=True)
    time.sleep(0.02 if seq < 60 else 600)
"""


def test_killed_while_logging_keeps_what_was_sent(tmp_path, rrd):
    path = tmp_path / "killed.rrd"
    child = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True)
    for line in child.stdout:
        if int(line) == 60:
            break
    written = -1
    while written < (written := path.stat().st_size):  # what is half written when it dies no reader takes
        time.sleep(0.5)
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.read()
    child.wait()
    child.stdout.close()
    with pytest.warns(RerunWarning, match="no footer"):
        kept = len(rrd(path).rows("/m1/signals/outputs/y_x"))
    assert kept >= 50 * 40
