"""One service, many simulated machines, and everything going wrong around them at random (seeded).

    python benchmarks/soak/run.py --minutes 60 --rigs 8 --seed 1 --folder SOAK

The service runs in a process of its own, the rigs in two (several agents each), the second in a network namespace; the proxies between them are
stalled and cut, its cable is pulled, processes are stopped, hung, killed and started under wall clocks of another day, the disk is filled and recordings are
deleted, a stranger sends rubbish, floods and half-opens connections, a second agent claims a machine's id (19 kinds in all), and every other
machine has a fault. Afterwards the recordings on disk are counted sample by sample: every gap must lie in the time of something that was
done to it on purpose and may lose samples: a deleted recording, a process of rigs that is hung, killed or stopped. Needs root, for the disk and the
namespace. What is done, and how the service fares, is written to the folder as it happens. Prints what was held; exit 1 when anything was not.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import sys
import threading
import time
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support

from scipy.stats import poisson

from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from benchmarks.soak.counting import bursts, count_alarms, count_samples, growth, processor, stored
from benchmarks.soak.disturbances import Disturbances
from benchmarks.soak.testbed import SmallDisk, Testbed, busy, cable, resident

DETECTORS = 3  # of bursts, each of which promises one false alarm in 1000 bursts: at most so many bursts in 1000 raise one
SAMPLE_BYTES = 80  # of eight channels in a recording, with what lies around them
QUIET_SECONDS = 60.0  # nothing is done at the end
DELIVERY_SECONDS = 300.0  # nor after it, for so long, while rigs deliver what they kept


class Progress:
    """What is seen while it runs, kept and written down at once: memory, processor, load, the longest waits of the service."""

    def __init__(self, testbed: Testbed) -> None:
        self.testbed, self.load = testbed, 0.0
        self.memory: list[tuple[float, int, int]] = []
        self.used: list[tuple[float, int, float]] = []
        self._over = threading.Event()
        for work, period in ((self._measure, 5.0), (self._ask, 20.0)):
            threading.Thread(target=self._for_ever, args=(work, period), daemon=True).start()

    def say(self, sentence: str) -> None:
        """Write a sentence down."""
        with (self.testbed.folder / "progress.log").open("a") as file:
            print(f"{datetime.datetime.now(datetime.UTC):%H:%M:%S} {sentence}", file=file)

    def end(self) -> None:
        """Measure no more."""
        self._over.set()

    def _for_ever(self, work, period: float) -> None:  # type: ignore[no-untyped-def]
        while not self._over.wait(period):
            work()

    def _measure(self) -> None:
        pid = self.testbed.service.pid
        self.load += (os.getloadavg()[0] - self.load) / (len(self.memory) + 1)
        self.memory.append((time.time(), pid, resident(pid)))
        self.used.append((time.time(), pid, busy(pid)))

    def _ask(self) -> None:
        load, mb = os.getloadavg()[0], resident(self.testbed.service.pid) / 1e6
        seen = f"load {load:.1f}, service {mb:.0f} MB, {self.testbed.waiting() / 1e6:.0f} MB wait on the rigs' disks"
        try:
            status = ask_service(read_site(self.testbed.service_site), "status", "kim")
            waits = ", ".join(f"{what} {wait:.2f} s" for what, wait in sorted(status["longest_waits"].items()))
            machines = "; ".join(f"{m['machine']} {m['state']} {m['reason']}" for m in status["machines"])
            self.say(
                f"{seen}; longest waits {waits}; dropped {status['recording_dropped']} {status['recording_failure']}; {machines}"
            )
        except AfdsvcError as error:
            self.say(f"{seen}; no status: {error}")


def run(testbed: Testbed, disturbances: Disturbances, progress: Progress, seconds: float) -> None:
    """Run for so long; the service is restarted in the first third only, so that its memory can be watched after."""
    began, rng = time.monotonic(), disturbances.rng
    time.sleep(min(15, seconds / 4))
    while (passed := time.monotonic() - began) < seconds - QUIET_SECONDS:
        done = disturbances.disturb(passed < seconds / 3)
        progress.say(f"{len(disturbances.done)}: {done.what} ({', '.join(done.machines)}) for {done.end - done.start:.1f} s")
        time.sleep(rng.uniform(2, 5))
    time.sleep(max(seconds - (time.monotonic() - began), 0))
    began = time.monotonic()
    while testbed.waiting() > 20e6 and time.monotonic() - began < DELIVERY_SECONDS:
        time.sleep(5)
    progress.say(
        f"{testbed.waiting() / 1e6:.0f} MB wait on the rigs' disks {QUIET_SECONDS + time.monotonic() - began:.0f} s after the last disturbance"
    )


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--disk", type=float, help="megabytes of the disk of the recordings, which is memory; by default what the samples take"
    )
    parser.add_argument(
        "--folder", type=Path, required=True, help="new folder for all that is written, which stays but for the recordings"
    )
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True)
    folder = asked.folder.resolve()
    with (
        SmallDisk(folder / "recordings", asked.disk or 500 + 300_000 * asked.minutes * asked.rigs * SAMPLE_BYTES / 1e6) as disk,
        cable() as name,
    ):
        testbed = Testbed(folder, asked.rigs, name, asked.seed)
        disturbances = Disturbances(testbed, disk, Random(asked.seed))
        for group in range(len(testbed.groups)):
            testbed.start_rigs(group)  # first, on purpose: both may be started in any order
        testbed.start_service()
        testbed.wait_ready()
        progress = Progress(testbed)
        try:
            run(testbed, disturbances, progress, 60 * asked.minutes)
        finally:
            progress.end()
            took = testbed.stop()
        return tell(disturbances, progress, asked, took)


def tell(disturbances: Disturbances, progress: Progress, asked: argparse.Namespace, took: float) -> int:
    """Print what was held; returns 1 when anything was not."""
    testbed, done = disturbances.testbed, disturbances.done
    samples, accounted, missing, wrong = count_samples(testbed, done)
    named, healthy, false, never = count_alarms(testbed)
    unfinished = [
        p.name
        for p in (testbed.folder / "recordings").rglob("*.mcap")
        if Recording(p).loss and not Recording(p).metadata.get("recovered")
    ]
    errors = [
        f"{log.name}: {line}"
        for log in testbed.folder.glob("*.log")
        for line in log.read_text(errors="replace").splitlines()
        if "Traceback" in line
    ]
    print(
        f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, load while it ran {progress.load:.1f}, Python {platform.python_version()}, seed {asked.seed}"
    )
    print(f"{testbed.rigs} machines at 5 kHz for {asked.minutes:g} minutes")
    kinds = sorted({d.what for d in done})
    print(
        f"{len(done)} disturbances of {len(kinds)} kinds: " + ", ".join(f"{k} {sum(d.what == k for d in done)}" for k in kinds)
    )
    later = sum(len(block) for id in testbed.ids for block in stored(testbed, id))
    share = samples / (5000 * (progress.memory[-1][0] - testbed.began) * testbed.rigs)
    print(
        f"samples kept {samples} ({share:.1%} of all), at most {later} of them on the rigs' disks yet; gaps explained {accounted.total()} ({missing.total()} samples), unexplained {len(wrong)}"
    )
    for why, n in missing.most_common():
        print(f"  {accounted[why]} gaps, {n} samples: {why}")
    played = bursts(testbed)
    alarmed, expected = sum(bool(judged.fault) for judged in healthy), len(healthy) * DETECTORS / 1000
    chance = poisson.sf(alarmed - 1, expected)
    memory, percent = growth(progress.memory)
    print(f"faults identified correctly {named} of {len(testbed.faults)}; missed or misidentified {len(never)}")
    print(f"bursts: {sum(played.values())} asked for, {min(played.values())} to {max(played.values())} a machine")
    print(
        f"false alarms in {alarmed} of {len(healthy)} bursts judged on healthy machines; at most {expected:.1f} expected, chance of as many {chance:.2g}"
    )
    for sentence in false:
        print("  " + sentence)
    print(f"memory of the service: {memory}")
    print(f"processor of the service: {processor(progress.used):.0f} % of a core")
    print(
        f"service stopped in {took:.1f} s; recordings left unfinished {len(unfinished)}; tracebacks in all logs {len(errors)}"
    )
    left = [f"{id}: {n} bursts only" for id, n in played.items() if 2 * n < max(played.values())]
    beyond = [*([f"{alarmed} false alarms"] if chance < 0.01 else []), *([f"memory: {memory}"] if abs(percent) > 5 else [])]
    bad = [*wrong, *beyond, *left, *never, *unfinished, *errors, *testbed.stuck, *[d.what for d in done if "NOT" in d.what]]
    for sentence in bad[:40]:
        print("  !", sentence)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
