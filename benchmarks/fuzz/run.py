"""A million hostile inputs: wire messages, burst requests, recordings, tables, models, site files.

    nice -n 10 python benchmarks/fuzz/run.py --inputs 1000000

Every input must end in a value or in one sentence (`AfdsvcError`), within 5 s and 1 GB. Each target runs in processes of its
own, so that a crash of a library below is counted too; input ``i`` of a target depends on target, seed and ``i`` alone, and
is made again with ``--only TARGET --first I --inputs 1``. Prints the count and what was found; exit 1 when anything was.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support

SHARES = {
    "wire": 0.76, "burst": 0.01, "recording": 0.03, "csv": 0.04, "npz": 0.04, "parquet": 0.01, "mat": 0.02, "mat73": 0.01,
    "model": 0.02, "site": 0.02, "tdms": 0.01, "ulog": 0.01, "bag": 0.01, "db3": 0.01,
}  # fmt: skip
SECONDS, MEMORY = 5.0, 1 << 30


class TooLong(BaseException):
    """An input took more than `SECONDS`."""


def late(*_: object) -> None:
    """End the input that takes too long."""
    raise TooLong


def work(name: str, seed: int, first: int, count: int, progress: Path) -> None:
    """Eat inputs in this process, telling where it stands in ``progress``; print what is found as JSON lines."""
    from benchmarks.support.hostile import TARGETS

    warnings.simplefilter("ignore")
    scratch = "/dev/shm" if Path("/dev/shm").is_dir() else None
    signal.signal(signal.SIGALRM, late)
    with tempfile.TemporaryDirectory(dir=scratch) as folder, progress.open("r+b", buffering=0) as reported:
        target = TARGETS[name](Path(folder))
        for i in range(10):
            swallow(target, name, seed, -1 - i)  # warm up: compiled code and lazy imports are not the input's memory
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, mapped + MEMORY))
        accepted = 0
        for i in range(first, first + count):
            reported.seek(0)
            reported.write(i.to_bytes(8, "little"))
            accepted += swallow(target, name, seed, i)
        print(json.dumps({"accepted": accepted}), flush=True)


def swallow(target, name: str, seed: int, i: int) -> bool:  # type: ignore[no-untyped-def]
    """Eat one input; print what should not have happened."""
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        return bool(target.try_one(Random(f"{name}-{seed}-{i}")))
    except TooLong:
        print(json.dumps({"at": i, "what": f"more than {SECONDS:g} s"}), flush=True)
    except Exception as error:
        print(json.dumps({"at": i, "what": f"{type(error).__name__}: {str(error)[:150]}"}), flush=True)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return False


def study(name: str, seed: int, first: int, count: int) -> dict:
    """Return what a target did with its inputs; a process that dies is started again behind the input that killed it."""
    found, accepted, end, began = [], 0, first + count, time.monotonic()
    with tempfile.NamedTemporaryFile() as progress:
        while first < end:
            progress.seek(0)
            progress.write(first.to_bytes(8, "little"))
            progress.flush()
            command = [sys.executable, __file__, "--worker", name, "--seed", str(seed), "--first", str(first)]
            done = subprocess.run([*command, "--inputs", str(end - first), "--progress", progress.name], stdout=subprocess.PIPE, check=False)
            lines = [json.loads(line) for line in done.stdout.decode(errors="replace").splitlines() if line.startswith("{")]
            accepted += sum(line.get("accepted", 0) for line in lines)
            found += [line for line in lines if "what" in line]
            if done.returncode == 0:
                break
            at = int.from_bytes(Path(progress.name).read_bytes()[:8], "little")
            found.append({"at": at, "what": f"the process died: exit {done.returncode}"})
            first = at + 1
    return {"inputs": count, "accepted": accepted, "seconds": time.monotonic() - began, "found": found}


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=SHARES)
    parser.add_argument("--worker", choices=SHARES, help=argparse.SUPPRESS)
    parser.add_argument("--progress", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.worker:
        work(asked.worker, asked.seed, asked.first, asked.inputs, asked.progress)
        return 0
    today = datetime.date.today()
    print(f"{today}, {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, seed {asked.seed}", flush=True)
    total, bad = 0, 0
    for name, share in {asked.only: 1.0}.items() if asked.only else SHARES.items():
        done = study(name, asked.seed, asked.first, round(asked.inputs * share))
        total, bad = total + done["inputs"], bad + len(done["found"])
        print(f"{name:10} {done['inputs']:8} inputs, {done['accepted']:7} accepted, {done['seconds']:6.0f} s, {len(done['found'])} found", flush=True)
        for item in done["found"][:10]:
            print(f"    input {item['at']}: {item['what']}", flush=True)
    print(f"{total} inputs, {bad} found", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
