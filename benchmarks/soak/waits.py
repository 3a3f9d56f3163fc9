"""How long leases and requests wait while the service judges, records and designs, and others explain, on all cores.

    python benchmarks/soak/waits.py --minutes 3 --rigs 8

Every machine plays a diagnosis burst every few seconds; identification bursts, whose design is the longest work there is, are asked for one after
the other; as many processes as there are cores run `afdsvc design` and `afdsvc explain` without end. Leases are timed where they arrive,
beside the rigs, in a process of their own that only listens; requests where they are asked. Prints the longest waits; exit 1 when a lease was
renewed after more than 0.2 s or a request answered after more than 1 s.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support

from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.site import read_site
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.codec import decode
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import Lease
from benchmarks.soak.testbed import Testbed

LEASE, REQUEST = 0.2, 1.0  # seconds that are allowed


class Leases:
    """The renewals as they arrive: the intervals [s] between two of the same burst."""

    def __init__(self) -> None:
        self.intervals: list[float] = []
        self._last: dict[str, tuple[str, float]] = {}

    def hear(self, key: str, payload: bytes) -> None:
        """Take a renewal."""
        now, burst = time.monotonic(), decode(Lease, payload).burst
        before, when = self._last.get(key, ("", now))
        if before == burst:
            self.intervals.append(now - when)
        self._last[key] = (burst, now)


def without_end(over: threading.Event, command: list[str]) -> None:
    """Run a command again and again."""
    while not over.is_set():
        process = subprocess.Popen(
            [sys.executable, "-m", "afdsvc", *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None:
            if over.wait(0.2):
                process.kill()
        process.wait()


def listen(site_file: str, seconds: float) -> None:
    """Time the leases of all machines, and print the intervals; before all others, so that what is measured is not the listener."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -20)
    site, leases = read_site(Path(site_file)), Leases()
    with Transport(site.transport, False) as transport:
        for machine in site.machines:
            transport.subscribe(Keys(site.site).lease(machine.id), leases.hear, missed=False)
        time.sleep(seconds)
    print("\n".join(f"{interval:.6f}" for interval in leases.intervals))


def asked(site_file: Path, ids: list[str], over: threading.Event) -> list[float]:
    """Ask for identification bursts on one machine after the other, and for the status in between; return how long answers took [s]."""
    site, waits, n = read_site(site_file), [], 0
    while not over.wait(0.25):
        for name, arguments in (("status", {}), ("pause", {"machine": ids[0]}), ("resume", {"machine": ids[0]})):
            began = time.monotonic()
            with suppress(AfdsvcError):
                ask_service(site, name, "kim", **arguments)
                waits.append(time.monotonic() - began)
        n += 1
        if n % 8 == 0:
            machine = ids[n // 8 % len(ids)]
            threading.Thread(target=_burst, args=(site, machine), daemon=True).start()
    return waits


def _burst(site, machine: str) -> None:  # type: ignore[no-untyped-def]
    with suppress(AfdsvcError):
        ask_service(site, "burst", "kim", machine=machine, purpose="identify")


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--listen", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        listen(options.listen, 60 * options.minutes)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        return measure(Testbed(Path(folder), options.rigs), options.minutes)


def measure(testbed: Testbed, minutes: float) -> int:
    """Run service, rigs, load and listener, and print what was measured."""
    over, waits = threading.Event(), []
    for group in range(len(testbed.groups)):
        testbed.start_rigs(group)
    testbed.start_service()
    testbed.wait_ready()
    time.sleep(20)  # the first samples, after which loops are compiled and bursts played
    example = next((Path(__file__).parents[2] / "recordings" / "shipped").rglob("*.mcap"))
    busy = [
        ["design", str(testbed.service_site), "--machine", testbed.ids[0], "--json"],
        ["explain", str(example), "--out", str(testbed.folder / "explained"), "--json"],
    ]
    threads = [threading.Thread(target=without_end, args=(over, busy[i % 2])) for i in range(os.cpu_count() or 1)]
    threads.append(threading.Thread(target=lambda: waits.extend(asked(testbed.service_site, testbed.ids, over))))
    for thread in threads:
        thread.start()
    command = [sys.executable, __file__, "--listen", str(testbed.service_site), "--minutes", str(minutes)]
    heard = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    load, intervals = os.getloadavg()[0], sorted(map(float, heard.stdout.split()))
    own = ask_service(read_site(testbed.service_site), "status", "kim")["longest_waits"]
    over.set()
    for thread in threads:
        thread.join(60)
    testbed.stop()
    print(
        f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, load at the end {load:.1f}, Python {platform.python_version()}"
    )
    print(f"{testbed.rigs} machines at 5 kHz for {minutes:g} minutes, design and explain beside them on all cores")
    print(
        f"leases: {len(intervals)} renewals, median interval {intervals[len(intervals) // 2]:.3f} s, longest {intervals[-1]:.3f} s, 99.9 % within {intervals[int(0.999 * len(intervals))]:.3f} s"
    )
    print(f"requests: {len(waits)} answered, longest {max(waits):.3f} s with the connection made for each")
    print("the service's own longest waits: " + ", ".join(f"{what} {wait:.3f} s" for what, wait in sorted(own.items())))
    return int(intervals[-1] > LEASE or max(waits) > REQUEST)


if __name__ == "__main__":
    sys.exit(main())
