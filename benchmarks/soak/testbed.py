"""The service, the rigs, the network and the disk of a soak: started, stopped, cut, filled and measured."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from benchmarks.support.proxy import Proxy

FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")
HERE = Path(__file__).parent
CACHE_BLOCKS = 400  # 20 s of samples a rig keeps in memory for a service that is away
STORE_MEGABYTES = 200.0  # and on its disk: 8 minutes
OURS, THEIRS = "198.18.78.1", "198.18.78.2"  # the two ends of the cable (RFC 2544: for benchmarks, routed nowhere)
CLOCKS = (-7200, 86400, 400 * 86400)  # seconds a wall clock is wrong by after some restarts
ENDING_SECONDS = 60.0  # a process that has not ended so long after a signal is stuck, and killed
LISTENING_SECONDS = 180.0  # and a service that does not listen so long after its start
SHIFT = """#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
int clock_gettime(clockid_t id, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(id, t);
    if (id == CLOCK_REALTIME) t->tv_sec += atol(getenv("WRONG_BY"));
    return failed;
}
"""  # preloaded into a process, makes its wall clock wrong by so many seconds


class Testbed:
    """One service and two processes of rigs, half of which have a fault, joined by proxies; the second process behind a cable if there is one."""

    service: subprocess.Popen[bytes]

    def __init__(self, folder: Path, rigs: int, cable: str = "", seed: int = 0) -> None:
        self.folder, self.rigs, self.cable, self.port, self.began = folder, rigs, cable, free_port(), time.time()
        self.ids = [f"m{i + 1}" for i in range(rigs)]
        self.faults = {id: FAULTS[i // 2 % 4] for i, id in enumerate(self.ids) if i % 2}
        half = (rigs + 1) // 2
        self.groups = [group for group in (tuple(self.ids[:half]), tuple(self.ids[half:])) if group]
        ends = ("127.0.0.1", OURS if cable else "127.0.0.1")[: len(self.groups)]
        self.proxies = [Proxy(self.port, host=host) for host in ends]
        self._starts = 10_000 * seed  # numbered in all soaks, so that no two have the same noise
        self.service_site = self._site("service.toml", "127.0.0.1", self.port)
        self._ends = [(host, proxy.port) for host, proxy in zip(ends, self.proxies, strict=True)]
        self.rig_sites = [self._site(f"rigs{i}.toml", *end) for i, end in enumerate(self._ends)]
        self.shift = folder / "shift.so"
        (folder / "shift.c").write_text(SHIFT)
        subprocess.run(["cc", "-shared", "-fPIC", "-o", self.shift, folder / "shift.c", "-ldl"], check=True)
        self.agents: dict[int, subprocess.Popen[bytes]] = {}
        self.stuck: list[str] = []

    def _site(self, name: str, host: str, port: int) -> Path:
        machines = ""
        for i, id in enumerate(self.ids):
            fault = (
                f'faults = [{{name = "{self.faults[id]}", severity = -0.5, at_seconds = 12.0}}]' if id in self.faults else ""
            )
            machines += f"""
[[machines]]
id = "{id}"
plant = "gas_bearing"
driver = {{seed = {i + self.rigs * self._starts}{", " + fault if fault else ""}}}
bursts = {{every_seconds = 9.0, jitter_seconds = 2.0, first_after_seconds = {2 + i % 4}.0, seconds = 2.0}}
"""
        path = self.folder / name
        path.write_text(f"""site = "soak"
[transport]
listen = ["tcp/{host}:{port}"]
trusted_network = true
cache_blocks = {CACHE_BLOCKS}
store = "store"
store_megabytes = {STORE_MEGABYTES}
[recording]
folder = "recordings"
max_minutes = 5
keep_days = 30
[alarms]
before_seconds = 10
{machines}""")
        return path

    def start_service(self, wrong_by: int = 0) -> None:
        """Start the service, with its wall clock wrong by so many seconds."""
        command = [sys.executable, "-m", "afdsvc", "serve", str(self.service_site), "--log", "json"]
        self.service = self._started("service.log", command, wrong_by)

    def start_rigs(self, group: int, wrong_by: int = 0) -> None:
        """Start one process of rigs, with its wall clock wrong by so many seconds, and with noise of its own: the same would give the same false alarms."""
        self._starts += 1
        self._site(self.rig_sites[group].name, *self._ends[group])
        command = [*self.place(group), sys.executable, str(HERE / "rigs.py"), str(self.rig_sites[group]), *self.groups[group]]
        self.agents[group] = self._started(f"rigs{group}.log", command, wrong_by)

    def _started(self, log: str, command: list[str], wrong_by: int) -> subprocess.Popen[bytes]:
        clock = {"LD_PRELOAD": str(self.shift), "WRONG_BY": str(wrong_by)} if wrong_by else {}
        with (self.folder / log).open("ab") as file:
            return subprocess.Popen(command, stderr=file, stdout=file, env={**os.environ, **clock})

    def place(self, group: int) -> list[str]:
        """Return what puts a command on the computer of a group of rigs."""
        return ["ip", "netns", "exec", self.cable] if self.cable and group else []

    def wait_ready(self) -> None:
        """Wait until the service listens; one that never does is reported."""
        until = time.monotonic() + LISTENING_SECONDS
        while time.monotonic() < until:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=0.5):
                return
            time.sleep(0.1)
        self._report(self.service, f"the service did not listen within {LISTENING_SECONDS:g} s")

    def end(self, process: subprocess.Popen[bytes], sent: signal.Signals = signal.SIGTERM) -> float:
        """End a process; returns how long it took [s]. One that is stuck is reported and killed."""
        began = time.monotonic()
        process.send_signal(sent)
        try:
            process.wait(ENDING_SECONDS)
        except subprocess.TimeoutExpired:
            self._report(process, f"process {process.pid} did not end within {ENDING_SECONDS:g} s of {sent.name}")
            process.kill()
            process.wait(ENDING_SECONDS)
        return time.monotonic() - began

    def _report(self, process: subprocess.Popen[bytes], sentence: str) -> None:
        """Note what is stuck, and where, if py-spy is installed."""
        self.stuck.append(sentence)
        with (self.folder / "stuck.log").open("a") as file, suppress(subprocess.TimeoutExpired):
            print(sentence, file=file, flush=True)
            if spy := shutil.which("py-spy"):
                subprocess.run([spy, "dump", "--pid", str(process.pid)], stdout=file, stderr=file, check=False, timeout=30)

    def stop(self) -> float:
        """Stop everything in order; returns how long the service took [s]."""
        for agents in self.agents.values():
            self.end(agents)
        time.sleep(1)
        took = self.end(self.service)
        for proxy in self.proxies:
            proxy.close()
        return took

    def true_time(self, seconds: float) -> float:
        """Return the Unix time at which a wall clock that may be wrong read ``seconds`` during the run."""
        right = (seconds - shift for shift in (0, *CLOCKS) if self.began <= seconds - shift <= time.time() + 1)
        return next(right, seconds)

    def waiting(self) -> int:
        """Return the bytes that wait on the disks of the rigs for their delivery."""
        with suppress(FileNotFoundError):
            return sum(path.stat().st_size for path in self.folder.glob("store/*.blocks"))
        return 0


def ip(*arguments: str) -> None:
    """Arrange the network."""
    subprocess.run(["ip", *arguments], check=True)


@contextmanager
def cable() -> Iterator[str]:
    """A network namespace and a cable to it, both of that name; needs root."""
    name = f"soak{os.getpid() % 10_000}"
    ip("netns", "add", name)
    try:
        ip("link", "add", name, "type", "veth", "peer", "name", "rig0", "netns", name)
        ip("addr", "add", f"{OURS}/30", "dev", name)
        ip("link", "set", name, "up")
        ip("-n", name, "addr", "add", f"{THEIRS}/30", "dev", "rig0")
        for device in ("rig0", "lo"):
            ip("-n", name, "link", "set", device, "up")
        yield name
    finally:
        ip("netns", "del", name)


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def busy(pid: int) -> float:
    """Return the processor time [s] a process has used, 0 when it is gone."""
    with suppress(OSError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def resident(pid: int) -> int:
    """Return the resident memory [bytes] of a process, 0 when it is gone."""
    with suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


class SmallDisk:
    """A disk of a stated size that can be filled without harm; needs root."""

    def __init__(self, folder: Path, megabytes: float) -> None:
        self.folder, self._bytes = folder, round(megabytes * 1e6)

    def __enter__(self) -> SmallDisk:
        self.folder.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={self._bytes}", "afdsvc-soak", str(self.folder)], check=True)
        return self

    def __exit__(self, *error: object) -> None:
        subprocess.run(["umount", "-l", str(self.folder)], check=True)

    def fill(self) -> None:
        """Make the disk as small as what is on it."""
        while True:
            used = shutil.disk_usage(self.folder).used
            if self._resize(used + 65536):
                return

    def empty(self) -> None:
        """Give it its size again."""
        self._resize(self._bytes)

    def _resize(self, size: int) -> bool:
        return (
            subprocess.run(
                ["mount", "-o", f"remount,size={size}", str(self.folder)], check=False, stderr=subprocess.DEVNULL
            ).returncode
            == 0
        )
