"""A batch gives one row per recording, goes on where it was killed, and no bad recording spoils another."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from afdsvc.app.batch import Batch, run_batch
from afdsvc.errors import BadInput

SHIPPED = sorted((Path(__file__).parents[2] / "recordings" / "shipped").glob("*.mcap"))
TASK = Batch("diagnose", detectors=("regression",))


def rows(path: Path) -> list[dict]:
    return pq.read_table(path).to_pylist()


def test_every_recording_is_a_row_and_a_bad_one_says_why(tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no recording at all")
    out = tmp_path / "found.parquet"
    done = run_batch(TASK, [*SHIPPED, broken], out, jobs=1)
    assert (done.rows, done.failed, done.kept) == (6, 1, 0)
    found = {Path(r["recording"]).stem: r for r in rows(out)}
    assert "broken.mcap" in found["broken"]["error"]
    assert (found["gas_bearing_nominal"]["verdict"], found["gas_bearing_nominal"]["what"]) == ("no fault", None)
    for name in ("horizontal_actuator", "horizontal_sensor", "vertical_actuator", "vertical_sensor"):
        row = found[f"gas_bearing_{name}"]
        assert (row["verdict"], row["what"]) == ("fault", name)
        assert abs(row["value"] + 0.5) < 4 * row["sd"]


def test_what_is_done_is_not_done_again_unless_the_recording_has_changed(tmp_path):
    recordings = [Path(shutil.copy(p, tmp_path)) for p in SHIPPED[:2]]
    out = tmp_path / "found.parquet"
    run_batch(TASK, recordings, out, jobs=1)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "found.parquet.parts").glob("*.json")}
    assert run_batch(TASK, recordings, out, jobs=1).kept == 2
    assert {p: p.stat().st_mtime_ns for p in before} == before
    os.utime(recordings[0], ns=(1, 1))
    assert run_batch(TASK, recordings, out, jobs=1).kept == 1
    assert run_batch(Batch("diagnose", detectors=("chi_square",)), recordings, out, jobs=1).kept == 0


def test_a_batch_that_is_killed_goes_on(tmp_path):
    recordings = []
    for i in range(12):
        recordings.append(tmp_path / f"r{i}.mcap")
        shutil.copy(SHIPPED[i % len(SHIPPED)], recordings[-1])
    out, parts = tmp_path / "found.parquet", tmp_path / "found.parquet.parts"
    command = [sys.executable, "-m", "afdsvc", "batch", "diagnose", *map(str, recordings), "--out", str(out), "--jobs", "1"]
    process = subprocess.Popen([*command, "--detector", "regression"], start_new_session=True, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while len(list(parts.glob("*.json"))) < 2:
        assert time.monotonic() < deadline, "the batch never began"
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    there = len(list(parts.glob("*.json")))
    assert there < 12
    assert not out.exists()
    done = run_batch(TASK, recordings, out, jobs=1)
    assert (done.rows, done.failed) == (12, 0)
    assert done.kept == there


def test_wrong_wishes_are_named(tmp_path):
    with pytest.raises(BadInput, match="task 'paint'; expected one of diagnose, identify, explain"):
        Batch("paint")
    with pytest.raises(BadInput, match="task 'identify' needs --model"):
        Batch("identify")
    with pytest.raises(BadInput, match=r"nowhere\.mcap: cannot be read"):
        run_batch(TASK, [tmp_path / "nowhere.mcap"], tmp_path / "t.parquet")
    with pytest.raises(BadInput, match="no recording is given"):
        run_batch(TASK, [], tmp_path / "t.parquet")
