"""One service, many simulated machines, and everything going wrong around them at random (seeded).

    python benchmarks/soak/run.py --minutes 30 --rigs 8 --seed 1

The service runs in a process of its own, the rigs in two (several agents each), the second in a network namespace; the proxies between them are
stalled and cut, its cable is pulled, processes are stopped, hung, killed and started under wall clocks of another day, the disk is filled and recordings are
deleted, a stranger sends rubbish, floods and half-opens connections, a second agent claims a machine's id (18 kinds in all), and every other
machine has a fault. Afterwards the recordings on disk are counted sample by sample: every gap must lie in the time of something that was
done to it on purpose. Needs root, for the disk and the namespace. Prints what was held; exit 1 when anything was not.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support

from scipy.stats import poisson

from afdsvc.api.signals import Block
from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.hal.store import records
from afdsvc.service import operator_requests
from afdsvc.service.notifications import History
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import AlarmKind, BurstStop, Lease
from benchmarks.support.messages import EXAMPLES
from benchmarks.support.mutation import mutate_bytes
from benchmarks.support.proxy import Proxy

FAULTS = ("horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")
HERE = Path(__file__).parent
CACHE_BLOCKS = 400  # 20 s of samples a rig keeps in memory for a service that is away
STORE_MEGABYTES = 200.0  # and on its disk: 8 minutes
CLOCKS = (-3600, 86400, 400 * 86400)  # seconds a wall clock is wrong by after a restart
OURS, THEIRS = "198.18.78.1", "198.18.78.2"  # the two ends of the cable (RFC 2544: for benchmarks, routed nowhere)
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
DETECTORS = 3  # of bursts, each of which promises one false alarm in 1000 bursts
SAMPLE_BYTES = 80  # of eight channels in a recording, with what lies around them
MARGIN = 15.0  # seconds after a disturbance in which its gap may still begin: a reconnection takes some


@dataclass
class Disturbance:
    """Something done on purpose: what, to which machines, from when to when (Unix time)."""

    what: str
    machines: tuple[str, ...]
    start: float
    end: float = 0.0


@dataclass
class Soak:
    """Everything of one run."""

    folder: Path
    rigs: int
    rng: Random
    cable: str = ""
    done: list[Disturbance] = field(default_factory=list)
    memory: list[tuple[float, int, int]] = field(default_factory=list)
    busy: list[tuple[float, int, float]] = field(default_factory=list)
    load: float = 0.0

    def __post_init__(self) -> None:
        self.ids = [f"m{i + 1}" for i in range(self.rigs)]
        self.faults = {id: FAULTS[i // 2 % 4] for i, id in enumerate(self.ids) if i % 2}
        self.port, self.began = free_port(), time.time()
        half = (self.rigs + 1) // 2
        self.groups = [group for group in (tuple(self.ids[:half]), tuple(self.ids[half:])) if group]
        ends = ("127.0.0.1", OURS if self.cable else "127.0.0.1")[: len(self.groups)]
        self.proxies = [Proxy(self.port, host=host) for host in ends]
        self.service_site = self._site("service.toml", "127.0.0.1", self.port)
        self.rig_sites = [self._site(f"rigs{i}.toml", host, proxy.port) for i, (host, proxy) in enumerate(zip(ends, self.proxies, strict=True))]
        self.shift = self.folder / "shift.so"
        (self.folder / "shift.c").write_text(SHIFT)
        subprocess.run(["cc", "-shared", "-fPIC", "-o", self.shift, self.folder / "shift.c", "-ldl"], check=True)
        self.service: subprocess.Popen[bytes] | None = None
        self.processes: list[subprocess.Popen[bytes] | None] = [None] * len(self.groups)

    def _site(self, name: str, host: str, port: int) -> Path:
        machines = ""
        for i, id in enumerate(self.ids):
            fault = f'faults = [{{name = "{self.faults[id]}", severity = -0.5, at_seconds = 12.0}}]' if id in self.faults else ""
            machines += f"""
[[machines]]
id = "{id}"
plant = "gas_bearing"
driver = {{seed = {i}{", " + fault if fault else ""}}}
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
        with (self.folder / "service.log").open("ab") as log:
            self.service = subprocess.Popen(command, stderr=log, stdout=log, env=self.clock(wrong_by))

    def start_rigs(self, group: int, wrong_by: int = 0) -> None:
        """Start one process of rigs, with its wall clock wrong by so many seconds."""
        command = [*self.place(group), sys.executable, str(HERE / "rigs.py"), str(self.rig_sites[group]), *self.groups[group]]
        with (self.folder / f"rigs{group}.log").open("ab") as log:
            self.processes[group] = subprocess.Popen(command, stderr=log, stdout=log, env=self.clock(wrong_by))

    def place(self, group: int) -> list[str]:
        """Return what puts a command on the computer of a group of rigs."""
        return ["ip", "netns", "exec", self.cable] if self.cable and group else []

    def clock(self, wrong_by: int) -> dict[str, str]:
        """Return the environment of a process whose wall clock is wrong."""
        return {**os.environ, **({"LD_PRELOAD": str(self.shift), "WRONG_BY": str(wrong_by)} if wrong_by else {})}

    def wait_ready(self) -> None:
        """Wait until the service listens."""
        for _ in range(600):
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=0.5):
                return
            time.sleep(0.1)
        raise SystemExit("the service did not start")

    # ------------------------------------------------------------------------------------------------------ disturbances

    def disturb(self, restart_service: bool) -> None:
        """Do something bad and undo it."""
        acts = [
            self.kill_rigs, self.hang_rigs, self.stop_rigs, self.stall, self.cut, self.rubbish, self.twin, self.hang_service,
            self.delete_recording, self.fill_disk, self.half_open, self.flood, self.identify, self.false_receipts, self.step_clock_of_rigs,
            *[self.pull_cable] * bool(self.cable),
        ]  # fmt: skip
        act = self.rng.choice(acts + ([self.kill_service, self.stop_service, self.step_clock_of_service] if restart_service else []))
        act()

    def _note(self, what: str, machines: tuple[str, ...]) -> Disturbance:
        self.done.append(Disturbance(what, machines, time.time()))
        return self.done[-1]

    def kill_rigs(self) -> None:
        """Kill a process of rigs and start it again."""
        self._kill_rigs("rigs killed", 0)

    def step_clock_of_rigs(self) -> None:
        """Kill a process of rigs and start it under a wall clock that is wrong."""
        self._kill_rigs("clock of rigs stepped", self.rng.choice(CLOCKS))

    def _kill_rigs(self, what: str, wrong_by: int) -> None:
        group = self.rng.randrange(len(self.groups))
        noted = self._note(what, self.groups[group])
        process = self.processes[group]
        assert process is not None
        process.kill()
        process.wait()
        time.sleep(self.rng.uniform(0.2, 3))
        self.start_rigs(group, wrong_by)
        time.sleep(12)
        noted.end = time.time()

    def pull_cable(self) -> None:
        """Pull the cable of the second group for 20 s, seldom for 120 s, and put it back."""
        noted = self._note("cable pulled", self.groups[1])
        ip("link", "set", self.cable, "down")
        time.sleep(self.rng.choice((20, 20, 20, 120)))
        ip("link", "set", self.cable, "up")
        noted.end = time.time()

    def hang_rigs(self) -> None:
        """Stop a process of rigs for seconds up to a minute."""
        group = self.rng.randrange(len(self.groups))
        noted = self._note("rigs hung", self.groups[group])
        process = self.processes[group]
        assert process is not None
        process.send_signal(signal.SIGSTOP)
        time.sleep(self.rng.choice((*[self.rng.uniform(1, 12)] * 4, 60.0)))
        process.send_signal(signal.SIGCONT)
        noted.end = time.time()

    def stop_rigs(self) -> None:
        """Stop a process of rigs in order and start it again."""
        group = self.rng.randrange(len(self.groups))
        noted = self._note("rigs stopped in order", self.groups[group])
        process = self.processes[group]
        assert process is not None
        process.terminate()
        process.wait()
        time.sleep(self.rng.uniform(0.2, 3))
        self.start_rigs(group)
        time.sleep(12)
        noted.end = time.time()

    def hang_service(self) -> None:
        """Stop the service's process for some seconds, or for longer than a link lives."""
        assert self.service is not None
        seconds = self.rng.choice((self.rng.uniform(1, 8), self.rng.uniform(8, 25), self.rng.uniform(8, 60)))
        noted = self._note("service hung", tuple(self.ids))
        self.service.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.service.send_signal(signal.SIGCONT)
        noted.end = time.time()

    def delete_recording(self) -> None:
        """Delete the recording that is being written of one machine: what was in it is gone."""
        id = self.rng.choice(self.ids)
        written = sorted((self.folder / "recordings").glob(f"{id}-2*.mcap"), key=lambda path: path.stat().st_mtime)
        if written:
            began = next((b.t0_ns / 1e9 for b in Recording(written[-1]).blocks()), time.time())
            noted = self._note("recording deleted", (id,))
            written[-1].unlink()
            noted.start, noted.end = began, time.time()

    def fill_disk(self) -> None:
        """Leave no room on the disk of the recordings for some seconds."""
        noted = self._note("disk full", tuple(self.ids))
        ballast = self.folder / "recordings" / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(1 << 20))
        time.sleep(self.rng.uniform(3, 12))
        ballast.unlink()
        time.sleep(12)  # the recorder tries again every 10 s
        noted.end = time.time()

    def half_open(self) -> None:
        """Open 400 connections to the service and say nothing."""
        noted = self._note("connections left half-open", ())
        with ExitStack() as stack, suppress(OSError):
            for _ in range(400):
                stack.enter_context(socket.create_connection(("127.0.0.1", self.port), timeout=2))
            time.sleep(self.rng.uniform(2, 12))
        noted.end = time.time()

    def flood(self) -> None:
        """Ask the service as fast as it answers, for some seconds."""
        noted = self._note("flood of requests", ())
        with suppress(AfdsvcError), Transport(read_site(self.service_site).transport, False) as stranger:
            until = time.monotonic() + self.rng.uniform(2, 6)
            while time.monotonic() < until:
                operator_requests.ask(lambda payload: stranger.ask(Keys("soak").command(), payload, 2.0), "history", "eve")
        noted.end = time.time()

    def identify(self) -> None:
        """Ask for an identification burst, whose design is long work."""
        noted = self._note("identification burst asked for", ())
        with suppress(AfdsvcError):
            ask_service(read_site(self.service_site), "burst", "kim", machine=self.rng.choice(self.ids), purpose="identify")
        noted.end = time.time()

    def false_receipts(self) -> None:
        """Send leases and stops of machines and bursts that are not there."""
        noted = self._note("leases and stops of others", ())
        with suppress(AfdsvcError), Transport(read_site(self.service_site).transport, False) as stranger:
            for id in self.ids:
                stranger.publish(Keys("soak").lease(id), codec.encode(Lease(id, "b-none", 2.0)))
                with suppress(AfdsvcError):
                    stranger.ask(Keys("soak").stop(id), codec.encode(BurstStop(id, "nothing", "eve", "b-none")), 1.0)
        noted.end = time.time()

    def stall(self) -> None:
        """Let nothing through for some seconds."""
        noted = self._note("network stalled", tuple(self.ids))
        for proxy in self.proxies:
            proxy.stall()
        time.sleep(self.rng.uniform(1, 8))
        self.mend()
        noted.end = time.time()

    def cut(self) -> None:
        """Cut every connection, for seconds or for longer than the rigs' caches last."""
        noted = self._note("network cut", tuple(self.ids))
        for proxy in self.proxies:
            proxy.cut()
        time.sleep(self.rng.choice((self.rng.uniform(1, 5), self.rng.uniform(25, 40))))
        self.mend()
        noted.end = time.time()

    def mend(self) -> None:
        """Make the network whole."""
        for proxy in self.proxies:
            proxy.mend()

    def kill_service(self) -> None:
        """Kill the service and start it again."""
        self._kill_service("service killed", 0)

    def step_clock_of_service(self) -> None:
        """Kill the service and start it under a wall clock that is wrong."""
        self._kill_service("clock of the service stepped", self.rng.choice(CLOCKS))

    def _kill_service(self, what: str, wrong_by: int) -> None:
        noted = self._note(what, tuple(self.ids))
        assert self.service is not None
        self.service.kill()
        self._again(noted, wrong_by)

    def stop_service(self) -> None:
        """Stop the service in order and start it again."""
        noted = self._note("service stopped", tuple(self.ids))
        assert self.service is not None
        began = time.monotonic()
        self.service.terminate()
        self.service.wait()
        noted.what += f" in {time.monotonic() - began:.1f} s"
        self._again(noted)

    def _again(self, noted: Disturbance, wrong_by: int = 0) -> None:
        assert self.service is not None
        self.service.wait()
        time.sleep(self.rng.uniform(0.2, 3))
        self.start_service(wrong_by)
        self.wait_ready()
        time.sleep(3)
        noted.end = time.time()

    def rubbish(self) -> None:
        """Send mutants of every message on the keys of a machine, for a second."""
        id = self.rng.choice(self.ids)
        noted = self._note("rubbish sent", (id,))
        keys, examples = Keys("soak"), [data for _, data in EXAMPLES]
        with suppress(AfdsvcError), Transport(read_site(self.service_site).transport, False) as stranger:
            for _ in range(100):
                data = mutate_bytes(self.rng.choice(examples), self.rng.choice(examples), self.rng)
                for key in (keys.event(id), keys.description(id), keys.block(id), keys.lease(id)):
                    stranger.publish(key, data)
                with suppress(AfdsvcError):
                    stranger.ask(keys.burst(id), data, 1.0)
                time.sleep(0.01)
        noted.end = time.time()

    def twin(self) -> None:
        """Start a second agent for a machine that has one; it must refuse."""
        group = self.rng.randrange(len(self.groups))
        id = self.rng.choice(self.groups[group])
        noted = self._note("second agent", (id,))
        command = [*self.place(group), sys.executable, "-m", "afdsvc", "rig", str(self.rig_sites[group]), "--machine", id, "--seconds", "5"]
        done = subprocess.run(command, stderr=subprocess.PIPE, check=False)
        noted.what += " (refused)" if b"has a rig agent already" in done.stderr else f" (NOT refused: exit {done.returncode})"
        noted.end = time.time()

    # ------------------------------------------------------------------------------------------------------------ running

    def run(self, seconds: float) -> None:
        """Run for so long; the service is restarted in the first third only, so that its memory can be watched after."""
        for group in range(len(self.groups)):
            self.start_rigs(group)  # first, on purpose: both may be started in any order
        self.start_service()
        self.wait_ready()
        over = threading.Event()
        threading.Thread(target=self._watch_memory, args=(over,), daemon=True).start()
        began = time.monotonic()
        time.sleep(min(15, seconds / 4))
        while (passed := time.monotonic() - began) < seconds - 60:
            self.disturb(passed < seconds / 3)
            time.sleep(self.rng.uniform(3, 7))
        time.sleep(max(seconds - (time.monotonic() - began), 0))
        over.set()

    def stop(self) -> float:
        """Stop everything in order; returns how long the service took."""
        for process in self.processes:
            if process:
                process.terminate()
                process.wait(20)
        time.sleep(1)
        began = time.monotonic()
        if self.service:
            self.service.terminate()
            self.service.wait(30)
        for proxy in self.proxies:
            proxy.close()
        return time.monotonic() - began

    def keep_logs(self, folder: Path) -> None:
        """Copy the logs, and write down what was done when (UTC)."""
        folder.mkdir(parents=True, exist_ok=True)
        for log in self.folder.glob("*.log"):
            shutil.copy(log, folder)
        times = [f"{datetime.datetime.fromtimestamp(d.start, datetime.UTC):%H:%M:%S} for {d.end - d.start:.1f} s: {d.what} ({', '.join(d.machines)})\n" for d in self.done]
        (folder / "disturbances.txt").write_text("".join(times))

    def _watch_memory(self, over: threading.Event) -> None:
        while not over.wait(5):
            self.load += (os.getloadavg()[0] - self.load) / (len(self.memory) + 1)
            if self.service:
                pid = self.service.pid
                self.memory.append((time.time(), pid, resident(pid)))
                self.busy.append((time.time(), pid, busy(pid)))


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


# ------------------------------------------------------------------------------------------------------------------ counting


def wrong_by(soak: Soak, seconds: float) -> int:
    """Return by how much the wall clock was wrong that read ``seconds`` during the run."""
    return next((shift for shift in CLOCKS if soak.began <= seconds - shift <= time.time() and not soak.began <= seconds <= time.time()), 0)


def gaps(soak: Soak, blocks: Iterable[Block]) -> Iterator[tuple[float, float, int]]:
    """Yield the gaps in one machine's samples: Unix time they begin and end at, samples missing; and at last (0, 0, samples)."""
    spans: dict[str, list[tuple[int, int, float, float]]] = {}
    for block in blocks:
        ends = block.k0 + len(block)
        spans.setdefault(block.session, []).append((block.k0, ends, block.t0_ns / 1e9, block.t0_ns / 1e9 + len(block) * block.dt))
    total = 0
    for rows in spans.values():
        reached, until = 0, 0.0
        for k0, ends, since, till in sorted(rows):
            if until and k0 > reached:
                shift = wrong_by(soak, rows[0][2])
                yield until - shift, since - shift, k0 - reached
            total += max(ends - max(k0, reached), 0)
            reached, until = max(reached, ends), max(until, till)
    yield 0.0, 0.0, total


def explained(soak: Soak, id: str, start: float, end: float) -> str:
    """Return what was done to the machine around a gap, "" when nothing was."""
    return " and ".join(sorted({d.what for d in soak.done if id in d.machines and start <= d.end + MARGIN and end >= d.start - 1.0}))


def stored(soak: Soak, id: str) -> Iterator[Block]:
    """Yield what a rig keeps on its disk, to be delivered when it is started again."""
    for path in soak.folder.glob(f"store/{id}.*.blocks"):
        yield from map(codec.decode_block, records(path))


def count_samples(soak: Soak) -> tuple[int, Counter[str], Counter[str], list[str]]:
    """Return samples, gaps and samples missing by what was done then, and sentences about gaps nothing explains."""
    samples, accounted, missing = 0, Counter[str](), Counter[str]()
    wrong = []
    for id in soak.ids:
        recorded = (block for path in (soak.folder / "recordings").glob(f"{id}-2*.mcap") for block in Recording(path).blocks())
        for start, end, n in gaps(soak, chain(recorded, stored(soak, id))):
            if not start:
                samples += n
            elif why := explained(soak, id, start, end):
                accounted[why] += 1
                missing[why] += n
            else:
                wrong.append(f"{id}: {n} samples missing from {datetime.datetime.fromtimestamp(start, datetime.UTC):%H:%M:%S}, unexplained")
    return samples, accounted, missing, wrong


def count_alarms(soak: Soak) -> tuple[int, list[str], list[str]]:
    """Return the machines whose fault was told rightly, false alarms, and faults never told."""
    raised = [c.alarm for c in History(soak.folder / "recordings" / "soak-alarms.sqlite").changes(limit=100_000) if c.event == "raised"]
    faults = [a for a in raised if a.kind is AlarmKind.FAULT]
    told = {a.machine for a in faults if a.fault == soak.faults.get(a.machine)}
    false = [f"{a.id}: {a.sentence}" for a in faults if a.machine not in soak.faults]
    right = {"unnamed"}  # told before a burst has said which one it is
    beside = [f"{a.id} beside {soak.faults[a.machine]}" for a in faults if a.machine in soak.faults and a.fault not in {*right, soak.faults[a.machine]}]
    never = [f"{id}: {fault} was never told" for id, fault in soak.faults.items() if id not in told]
    return len(told), false, [*never, *beside]


def memory(soak: Soak) -> str:
    """Return how the resident memory of the service's last process went after its first third."""
    pid = soak.memory[-1][1] if soak.memory else 0
    rows = [m for _, p, m in soak.memory if p == pid and m]
    if len(rows) < 12:
        return "too short to say"
    warm = rows[len(rows) // 3 :]
    half = len(warm) // 2
    first, last = sum(warm[:half]) / half, sum(warm[half:]) / (len(warm) - half)
    return f"{first / 1e6:.0f} MB, then {last / 1e6:.0f} MB ({100 * (last / first - 1):+.1f} %) over {5 * len(warm)} s after {5 * (len(rows) - len(warm))} s"


def processor(soak: Soak) -> str:
    """Return how much of a core the service's last process used for each machine."""
    rows = [(t, used) for t, pid, used in soak.busy if soak.memory and pid == soak.memory[-1][1] and used]
    if len(rows) < 3:
        return "too short to say"
    (began, first), (over, last) = rows[len(rows) // 3], rows[-1]
    return f"{100 * (last - first) / (over - began):.0f} % of a core, {100 * (last - first) / (over - began) / soak.rigs:.1f} % a machine"


@contextmanager
def small_disk(folder: Path, megabytes: float) -> Iterator[None]:
    """Mount a disk of a stated size, which can be filled without harm; needs root."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes:.0f}m", "afdsvc-soak", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def bursts(soak: Soak) -> dict[str, int]:
    """Return how many bursts were asked of each machine."""
    return {
        id: len({r.burst.name for path in (soak.folder / "recordings").glob(f"{id}-2*.mcap") for r in Recording(path).requests()})
        for id in soak.ids
    }


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--disk", type=float, help="megabytes of the disk of the recordings, which is memory; by default what the samples take")
    parser.add_argument("--logs", type=Path, help="folder for the logs of all processes and the times of what was done")
    asked = parser.parse_args()
    disk = asked.disk or 500 + 300_000 * asked.minutes * asked.rigs * SAMPLE_BYTES / 1e6
    with tempfile.TemporaryDirectory() as folder, small_disk(Path(folder) / "recordings", disk), cable() as name:
        soak = Soak(Path(folder), asked.rigs, Random(asked.seed), name)
        try:
            soak.run(60 * asked.minutes)
        finally:
            stopped = soak.stop()
            if asked.logs:
                soak.keep_logs(asked.logs)
        return tell(soak, asked.minutes, asked.seed, stopped)


def tell(soak: Soak, minutes: float, seed: int, stopped: float) -> int:
    """Print what was held; returns 1 when anything was not."""
    samples, accounted, missing, wrong = count_samples(soak)
    told, false, never = count_alarms(soak)
    unfinished = [p.name for p in (soak.folder / "recordings").rglob("*.mcap") if Recording(p).loss and not Recording(p).metadata.get("recovered")]
    errors = [f"{log.name}: {line}" for log in soak.folder.glob("*.log") for line in log.read_text(errors="replace").splitlines() if "Traceback" in line]
    print(f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, load while it ran {soak.load:.1f}, Python {platform.python_version()}, seed {seed}")
    print(f"{soak.rigs} machines at 5 kHz for {minutes:g} minutes")
    kinds = sorted({d.what for d in soak.done})
    print(f"{len(soak.done)} disturbances: " + ", ".join(f"{k} {sum(d.what == k for d in soak.done)}" for k in kinds))
    later = sum(len(block) for id in soak.ids for block in stored(soak, id))
    print(f"samples kept {samples} ({samples / (300_000 * minutes * soak.rigs):.1%} of all), at most {later} of them on the rigs' disks yet; gaps explained {accounted.total()} ({missing.total()} samples), unexplained {len(wrong)}")
    for why, n in missing.most_common():
        print(f"  {accounted[why]} gaps, {n} samples: {why}")
    played = bursts(soak)
    expected = sum(played[id] for id in soak.ids if id not in soak.faults) * DETECTORS / 1000
    chance = poisson.sf(len(false) - 1, expected)
    print(f"faults identified correctly {told} of {len(soak.faults)}; missed or misidentified {len(never)}")
    print(f"bursts: {sum(played.values())} asked for, {min(played.values())} to {max(played.values())} a machine")
    print(f"false alarms {len(false)}; {expected:.1f} expected in the bursts of healthy machines, chance of as many {chance:.2g}")
    print(f"memory of the service: {memory(soak)}")
    print(f"processor of the service: {processor(soak)}")
    print(f"service stopped in {stopped:.1f} s; recordings left unfinished {len(unfinished)}; tracebacks in all logs {len(errors)}")
    beyond = false if chance < 0.01 else []
    left = [f"{id}: {n} bursts only" for id, n in played.items() if 2 * n < max(played.values())]
    bad = [*wrong, *beyond, *left, *never, *unfinished, *errors, *[d.what for d in soak.done if "NOT" in d.what]]
    for sentence in bad[:30]:
        print("  !", sentence)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
