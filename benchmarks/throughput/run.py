"""How many machines at 5 kHz does one service process hold, and what would each of its parts hold alone?

    python benchmarks/throughput/run.py --machines 10 20 40 60 --seconds 30

Two inputs, two outputs, alpha and beta: eight channels, blocks of 250, recording on, four detectors, a burst a minute on each
machine. The service is `afdsvc serve` in a process of its own, the machines are another. A number of machines is held when
every block that was sent has been judged and recorded: nothing dropped, nothing missing, the queue no longer than a second.
In the same run, each in a process of its own: zenoh alone (received and counted), the same MCAP alone, the detectors alone, and numpy on the
same arrays, before and after every number of machines. Rates are blocks for each second of processor time, so that other work on the computer
hardly counts; linear algebra has one thread everywhere. ``--json FILE`` keeps it all.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from alone import PARTS
from machine import LENGTH, site_text

from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.site import Site, read_site

HERE = Path(__file__).parent
RATE = 5000 / LENGTH  # blocks a second from one machine
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMBA")}  # set before a process imports numpy


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def alone(part: str) -> float:
    """Return blocks a second of processor time of one part, measured in a process of its own."""
    done = subprocess.run([sys.executable, str(HERE / "alone.py"), part], stdout=subprocess.PIPE, check=True)
    return float(done.stdout)


def used(pid: int) -> tuple[float, float]:
    """Return processor seconds and resident megabytes of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def blocks(site: Site) -> tuple[int, int, int]:
    """Return blocks judged, samples lost and messages dropped, as the service tells."""
    status = ask_service(site, "status", "benchmark")
    return sum(m["blocks"] for m in status["machines"]), sum(m["lost_blocks"] for m in status["machines"]), status["recording_dropped"]


def wait_for(site: Site, service: subprocess.Popen[bytes]) -> tuple[float, float]:
    """Wait until the service answers, then until it has rehearsed its bursts and is idle; returns both times [s]."""
    began, answers = time.monotonic(), 0.0
    while not answers:
        if service.poll() is not None:
            raise SystemExit("the service did not start")
        with suppress(AfdsvcError):
            ask_service(site, "status", "benchmark")
            answers = time.monotonic() - began
    before = used(service.pid)[0]
    for _ in range(120):
        time.sleep(1.0)
        after = used(service.pid)[0]
        if after - before < 0.1:
            break
        before = after
    return answers, time.monotonic() - began


def hold(machines: int, seconds: float) -> dict[str, Any]:
    """Return how a service got on with so many machines."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "site.toml"
        path.write_text(site_text(machines, free_port(), f"{folder}/recordings"))
        site = read_site(path)
        command = [sys.executable, "-m", "afdsvc", "serve", str(path)]
        with (Path(folder) / "log").open("wb") as log:
            service = subprocess.Popen(command, stdout=log, stderr=log)
        answers, idle = wait_for(site, service)
        load = subprocess.Popen(
            [sys.executable, str(HERE / "load.py"), str(path), str(seconds)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert load.stdout is not None
        assert load.stdin is not None
        time.sleep(min(6.0, seconds / 3))  # the load generator takes a while to begin, the first blocks to be compiled
        (cpu0, _), t0, (judged0, *_) = used(service.pid), time.monotonic(), blocks(site)
        load.stdout.readline()
        seen, lost, dropped = blocks(site)
        (cpu1, memory), t1, judged1 = used(service.pid), time.monotonic(), seen
        deadline = time.monotonic() + 10
        load.stdin.write(b"\n")
        load.stdin.flush()
        reported = json.loads(load.stdout.readline())
        waiting = reported["sent"] - seen
        while seen < reported["sent"] and time.monotonic() < deadline:
            time.sleep(0.2)
            seen, lost, dropped = blocks(site)
        load.wait(20)
        service.send_signal(signal.SIGTERM)
        service.wait(30)
        size = sum(p.stat().st_size for p in (Path(folder) / "recordings").glob("*.mcap")) / 1e6
        delays = reported.pop("latencies_s")
        return {
            "machines": machines, "seconds": seconds, "answers_s": answers, "idle_s": idle, "load": os.getloadavg()[0], **reported, "judged": seen, "lost_samples": lost,
            "dropped": dropped, "waiting_at_end": waiting, "blocks_per_s": (judged1 - judged0) / (t1 - t0),
            "cpu": (cpu1 - cpu0) / (t1 - t0), "per_core": (judged1 - judged0) / (cpu1 - cpu0), "memory_mb": memory, "recorded_mb": size, "decisions": len(delays),
            "latency_median_s": delays[len(delays) // 2] if delays else None,
            "latency_worst_s": delays[-1] if delays else None,
            "held": waiting <= machines * RATE and not lost and not dropped and seen == reported["sent"],
        }  # fmt: skip


def tell(row: dict[str, Any]) -> None:
    """Print one line of the table; numpy is measured before and after the service."""
    latency = f"{1e3 * row['latency_median_s']:.0f} / {1e3 * row['latency_worst_s']:.0f} ms" if row["decisions"] else "-"
    print(
        f"{row['machines']:4d} machines: {'held' if row['held'] else 'NOT held'}; {100 * row['cpu']:.0f} % of a core, "
        f"{row['waiting_at_end']} of {row['sent']} blocks waiting, {row['lost_samples']} samples lost, {row['dropped']} dropped; "
        f"decision {latency} after a burst ({row['bursts']} bursts); {row['memory_mb']:.0f} MB; "
        f"{row['per_core']:.0f} blocks for a second of processor time, {2 * row['per_core'] / (row['numpy_before'] + row['numpy_after']):.3f} of numpy; "
        f"listens after {row['answers_s']:.0f} s, ready after {row['idle_s']:.0f} s; load {row['load']:.1f}",
        flush=True,
    )


def main() -> int:
    """Measure and print; exit 1 when fewer than 40 machines were held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, nargs="+", default=[10, 20, 40, 60])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    print(f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}")
    os.environ.update(ONE_THREAD)
    parts = {name: alone(name) for name in PARTS}
    for name, rate in parts.items():
        print(f"{name} alone: {rate:.0f} blocks/s, {rate / RATE:.0f} machines", flush=True)
    rows = []
    for machines in asked.machines:
        numpy = parts["numpy"] if not rows else rows[-1]["numpy_after"]
        rows.append({"numpy_before": numpy, **hold(machines, asked.seconds), "numpy_after": alone("numpy")})
        tell(rows[-1])
    best = max((row["machines"] for row in rows if row["held"]), default=0)
    print(f"held: {best} machines in one process")
    for name in ("zenoh", "mcap", "judge"):
        print(f"  {name} alone as a ratio to numpy alone: {parts[name] / parts['numpy']:.3f}")
    if len(rows) > 1:
        slope = (rows[-1]["memory_mb"] - rows[0]["memory_mb"]) / (rows[-1]["machines"] - rows[0]["machines"])
        print(f"  memory per machine: {slope:.1f} MB")
    if asked.json:
        asked.json.write_text(json.dumps({"alone": parts, "rows": rows}, indent=1) + "\n")
    return 0 if best >= 40 else 1


if __name__ == "__main__":
    sys.exit(main())
