"""Does a batch over many recordings use both cores, and does it go on where it was killed?

    python benchmarks/batch/run.py --recordings 1000

Twenty different recordings of a gas bearing (4.5 s each, a burst of 2 s; every other one has a fault) stand under a thousand
names. One worker does a share of them, two workers do all; both rates are counted from the first finished recording, so that
the start of the workers is timed separately. The second run is killed in the middle and started again: what was done must not be done
again. Prints the ratio of the rates, and processor time per recording, which other work on the computer does not change much.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow.parquet as pq

sys.path.insert(0, str(Path(__file__).parents[1] / "throughput"))
from machine import Signals, Talker, commissioned, site_text

from afdsvc.app.pipelines import diagnosis_burst, pipeline_of
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load
from afdsvc.wire import codec
from afdsvc.wire.messages import BurstRequest

DIFFERENT = 20
QUIET, BLOCKS = 40, 90


def record(folder: Path) -> list[Path]:
    """Write the recordings that differ; returns their paths."""
    text = site_text(1, 7447, "recordings").replace("cache_blocks = 200", "")
    site = parse_site(text, "benchmark")
    machine = commissioned(site)
    burst = replace(diagnosis_burst(machine)(pipeline_of(machine, load()).problem), name="b1")  # type: ignore[union-attr]
    paths = []
    for i in range(DIFFERENT):
        faulty = replace(machine, plant=machine.augmented.close({"horizontal_actuator": -0.3})) if i % 2 else machine
        talker = Talker("m1", f"s{i}", Signals(faulty, i))
        recorder = Recorder(RecordingSettings(folder / f"r{i}.mcap"), Header(site.text, {}, {"machine": "m1"}))
        request = BurstRequest("m1", burst, 2.0, "benchmark", 10**18)
        recorder.request(codec.encode(request), request)
        for k in range(BLOCKS):
            if k == QUIET:
                talker.play(burst)
            data = talker.next(10**18 + k * 50_000_000)
            recorder.block(data, codec.decode_block(data))
        recorder.close()
        paths.append(recorder.path)
    return paths


@dataclass
class Run:
    """One run of ``afdsvc batch``: recordings done, seconds from the first to the last one, seconds to the first, processor time."""

    done: int
    seconds: float
    starting: float
    cpu: float

    @property
    def rate(self) -> float:
        """Recordings a second once the workers run."""
        return (self.done - 1) / self.seconds


def batch(recordings: list[Path], out: Path, jobs: int, kill_at: int = 0) -> Run:
    """Run the command; with ``kill_at`` it is killed when so many recordings are done."""
    parts, before = out.with_name(out.name + ".parts"), resource.getrusage(resource.RUSAGE_CHILDREN)
    listed = out.with_suffix(".txt")
    listed.write_text("\n".join(map(str, recordings)))
    command = [sys.executable, str(Path(__file__)), "--work", str(listed), str(out), str(jobs)]
    began, first, there = time.monotonic(), 0.0, len(list(parts.glob("*.json"))) if parts.exists() else 0
    process = subprocess.Popen(command, start_new_session=True)
    while process.poll() is None:
        count = sum(e.name.endswith(".json") for e in os.scandir(parts)) - there if parts.exists() else 0
        if count and not first:
            first = time.monotonic()
        if kill_at and count >= kill_at:
            os.killpg(process.pid, signal.SIGKILL)
        time.sleep(0.05)
    over, after = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = len(list(parts.glob("*.json"))) - there
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(done, over - first, first - began, cpu)


def work(listed: Path, out: Path, jobs: int) -> None:
    """Do what ``afdsvc batch diagnose`` does; a thousand names do not fit on every command line."""
    from afdsvc.app.batch import Batch, run_batch

    done = run_batch(Batch("diagnose", detectors=("regression",)), [Path(p) for p in listed.read_text().split("\n")], out, jobs)
    print(f"    {done.rows} rows, {done.failed} failed, {done.kept} kept from before", flush=True)


def verdicts(table: Path) -> str:
    """Return how many rows are right: a fault where there is one, none where there is none."""
    rows = pq.read_table(table).to_pylist()
    right = sum((int(Path(r["recording"]).stem.split("-")[1]) % 2 == 1) == (r["verdict"] == "fault") for r in rows)
    return f"{right} of {len(rows)} rows right"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--alone", type=int, default=200, help="recordings the single worker does")
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.work:
        work(Path(asked.work[0]), Path(asked.work[1]), int(asked.work[2]))
        return 0
    print(f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = record(folder)
        names = [folder / f"n{i:04d}-{i % DIFFERENT}.mcap" for i in range(asked.recordings)]
        for i, path in enumerate(names):
            os.link(made[i % DIFFERENT], path)
        halves = [batch(names[: asked.alone // 2], folder / "one-a.parquet", 1)]
        killed = batch(names, folder / "two.parquet", 2, kill_at=asked.recordings // 2)
        resumed = batch(names, folder / "two.parquet", 2)
        halves.append(batch(names[asked.alone // 2 : asked.alone], folder / "one-b.parquet", 1))
        reported = verdicts(folder / "two.parquet")
    alone = sum(h.done - 1 for h in halves) / sum(h.seconds for h in halves)
    both = (killed.done + resumed.done - 2) / (killed.seconds + resumed.seconds)
    cpu = sum(h.cpu for h in halves) / sum(h.done for h in halves)
    cpu2 = resumed.cpu / resumed.done
    print(f"one worker: {alone:.2f} recordings/s ({asked.alone} recordings, before and after), {cpu:.2f} s of processor each")
    print(f"two workers: {both:.2f} recordings/s ({killed.done} until killed, {resumed.done} after), {cpu2:.2f} s of processor each")
    print(f"ratio {both / alone:.2f}; workers start in {halves[0].starting:.1f} s (one), {resumed.starting:.1f} s (two); load {os.getloadavg()[0]:.1f}")
    again = killed.done + resumed.done - asked.recordings
    print(f"killed in the middle and resumed: {again} recordings done twice; {reported}")
    return 0 if both / alone >= 1.8 and not again else 1


if __name__ == "__main__":
    sys.exit(main())
