"""What is done to a testbed on purpose: one thing at a time, each kind before any comes again, and undone."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from random import Random

from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec, requests
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstStop, Lease
from benchmarks.soak.testbed import CLOCKS, SmallDisk, Testbed, ip
from benchmarks.support.messages import EXAMPLES
from benchmarks.support.mutation import mutate_bytes

RETURNING_SECONDS = 12.0  # until rigs that were started have their loops compiled and their bursts begun; a recorder tries a disk again every 10 s


@dataclass
class Disturbance:
    """Something done on purpose: what, to which machines, from when to when (Unix time)."""

    what: str
    machines: tuple[str, ...]
    start: float
    end: float = float("inf")


class Disturbances:
    """Everything that can be done to a testbed, drawn from ``rng``; ``done`` is what was done so far."""

    def __init__(self, testbed: Testbed, disk: SmallDisk, rng: Random) -> None:
        self.testbed, self.disk, self.rng, self.done = testbed, disk, rng, list[Disturbance]()
        self._deck: list[Callable[[], None]] = []
        self._of_service = [self.kill_service, self.stop_service, self.step_clock_of_service]
        self._acts = [
            self.kill_rigs, self.hang_rigs, self.stop_rigs, self.stall, self.cut, self.rubbish, self.twin, self.hang_service,
            self.delete_recording, self.fill_disk, self.half_open, self.flood, self.identify, self.false_receipts, self.step_clock_of_rigs,
            *[self.pull_cable] * bool(testbed.cable),
        ]  # fmt: skip

    def disturb(self, restart_service: bool) -> Disturbance:
        """Do something bad and undo it."""
        if not self._deck:
            self._deck = self._acts + self._of_service * restart_service
            self.rng.shuffle(self._deck)
        act = self._deck.pop()
        if act in self._of_service and not restart_service:
            return self.disturb(False)
        act()
        return self.done[-1]

    @contextmanager
    def _noted(self, what: str, machines: tuple[str, ...] = ()) -> Iterator[Disturbance]:
        self.done.append(noted := Disturbance(what, machines, time.time()))
        yield noted
        noted.end = time.time()

    def _group(self) -> tuple[int, tuple[str, ...]]:
        group = self.rng.randrange(len(self.testbed.groups))
        return group, self.testbed.groups[group]

    def _everybody(self) -> tuple[str, ...]:
        return tuple(self.testbed.ids)

    def _stranger(self) -> Transport:
        return Transport(read_site(self.testbed.service_site).transport, False)

    # -------------------------------------------------------------------------------------------------------------- rigs

    def kill_rigs(self) -> None:
        """Kill a process of rigs and start it again."""
        self._restart_rigs("rigs killed", signal.SIGKILL)

    def step_clock_of_rigs(self) -> None:
        """Kill a process of rigs and start it under a wall clock that is wrong."""
        self._restart_rigs("clock of rigs stepped", signal.SIGKILL, self.rng.choice(CLOCKS))

    def stop_rigs(self) -> None:
        """Stop a process of rigs in order and start it again."""
        self._restart_rigs("rigs stopped in order", signal.SIGTERM)

    def _restart_rigs(self, what: str, sent: signal.Signals, wrong_by: int = 0) -> None:
        group, machines = self._group()
        with self._noted(what, machines):
            self.testbed.end(self.testbed.agents[group], sent)
            time.sleep(self.rng.uniform(0.2, 3))
            self.testbed.start_rigs(group, wrong_by)
            time.sleep(RETURNING_SECONDS)

    def hang_rigs(self) -> None:
        """Stop a process of rigs for seconds up to a minute."""
        group, machines = self._group()
        with self._noted("rigs hung", machines):
            self._hang(self.testbed.agents[group], self.rng.choice((*[self.rng.uniform(1, 12)] * 4, 60.0)))

    def twin(self) -> None:
        """Start a second agent for a machine that has one; it must refuse."""
        group, machines = self._group()
        id, testbed = self.rng.choice(machines), self.testbed
        with self._noted("second agent", (id,)) as noted:
            command = [
                *testbed.place(group),
                sys.executable,
                "-m",
                "afdsvc",
                "rig",
                str(testbed.rig_sites[group]),
                "--machine",
                id,
                "--seconds",
                "5",
            ]
            try:
                done = subprocess.run(command, stderr=subprocess.PIPE, check=False, timeout=120)
                refused = b"has a rig agent already" in done.stderr
                noted.what += " (refused)" if refused else f" (NOT refused: exit {done.returncode})"
            except subprocess.TimeoutExpired:
                noted.what += " (NOT refused within 120 s, killed)"

    # ----------------------------------------------------------------------------------------------------------- service

    def kill_service(self) -> None:
        """Kill the service and start it again."""
        self._restart_service("service killed", signal.SIGKILL)

    def step_clock_of_service(self) -> None:
        """Kill the service and start it under a wall clock that is wrong."""
        self._restart_service("clock of the service stepped", signal.SIGKILL, self.rng.choice(CLOCKS))

    def stop_service(self) -> None:
        """Stop the service in order and start it again."""
        self._restart_service("service stopped in order", signal.SIGTERM)

    def _restart_service(self, what: str, sent: signal.Signals, wrong_by: int = 0) -> None:
        with self._noted(what, self._everybody()):
            self.testbed.end(self.testbed.service, sent)
            time.sleep(self.rng.uniform(0.2, 3))
            self.testbed.start_service(wrong_by)
            self.testbed.wait_ready()
            time.sleep(3)

    def hang_service(self) -> None:
        """Stop the service's process for some seconds, or for longer than a link lives."""
        with self._noted("service hung", self._everybody()):
            self._hang(
                self.testbed.service,
                self.rng.choice((self.rng.uniform(1, 8), self.rng.uniform(8, 25), self.rng.uniform(8, 60))),
            )

    @staticmethod
    def _hang(process: subprocess.Popen[bytes], seconds: float) -> None:
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)

    # -------------------------------------------------------------------------------------------------- network and disk

    def pull_cable(self) -> None:
        """Pull the cable of the second group for 20 s, seldom for 120 s, and put it back."""
        with self._noted("cable pulled", self.testbed.groups[1]):
            ip("link", "set", self.testbed.cable, "down")
            time.sleep(self.rng.choice((20, 20, 20, 120)))
            ip("link", "set", self.testbed.cable, "up")

    def stall(self) -> None:
        """Let nothing through for some seconds."""
        with self._noted("network stalled", self._everybody()):
            for proxy in self.testbed.proxies:
                proxy.stall()
            time.sleep(self.rng.uniform(1, 8))
            self._mend()

    def cut(self) -> None:
        """Cut every connection, for seconds or for longer than the rigs' caches last."""
        with self._noted("network cut", self._everybody()):
            for proxy in self.testbed.proxies:
                proxy.cut()
            time.sleep(self.rng.choice((self.rng.uniform(1, 5), self.rng.uniform(25, 40))))
            self._mend()

    def _mend(self) -> None:
        for proxy in self.testbed.proxies:
            proxy.mend()

    def delete_recording(self) -> None:
        """Delete the recording that is being written of one machine: what was in it is gone."""
        id = self.rng.choice(self.testbed.ids)
        written = sorted((self.testbed.folder / "recordings").glob(f"{id}-2*.mcap"), key=lambda path: path.stat().st_mtime)
        with self._noted("recording deleted", (id,)) as noted:
            if written:
                began = next((block.t0_ns / 1e9 for block in Recording(written[-1]).blocks()), noted.start)
                noted.start = self.testbed.true_time(began)
                written[-1].unlink()

    def fill_disk(self) -> None:
        """Leave no room on the disk of the recordings for some seconds."""
        with self._noted("disk full", self._everybody()):
            self.disk.fill()
            time.sleep(self.rng.uniform(3, 12))
            self.disk.empty()
            time.sleep(RETURNING_SECONDS)

    # ---------------------------------------------------------------------------------------------------------- strangers

    def half_open(self) -> None:
        """Open 400 connections to the service and say nothing."""
        with self._noted("connections left half-open"), ExitStack() as stack, suppress(OSError):
            for _ in range(400):
                stack.enter_context(socket.create_connection(("127.0.0.1", self.testbed.port), timeout=2))
            time.sleep(self.rng.uniform(2, 12))

    def flood(self) -> None:
        """Ask the service as fast as it answers, for some seconds."""
        with self._noted("flood of requests"), suppress(AfdsvcError), self._stranger() as stranger:
            until = time.monotonic() + self.rng.uniform(2, 6)
            while time.monotonic() < until:
                with suppress(AfdsvcError):
                    requests.ask(lambda payload: stranger.ask(Keys("soak").command(), payload, 2.0), "history", "eve")

    def identify(self) -> None:
        """Ask for an identification burst, whose design is long work."""
        with self._noted("identification burst asked for"), suppress(AfdsvcError):
            ask_service(
                read_site(self.testbed.service_site),
                "burst",
                "kim",
                machine=self.rng.choice(self.testbed.ids),
                purpose="identify",
            )

    def false_receipts(self) -> None:
        """Send leases and stops of machines and bursts that are not there."""
        keys = Keys("soak")
        with self._noted("leases and stops of others"), suppress(AfdsvcError), self._stranger() as stranger:
            for id in self.testbed.ids:
                stranger.publish(keys.lease(id), codec.encode(Lease(id, "b-none", 2.0)))
                with suppress(AfdsvcError):
                    stranger.ask(keys.stop(id), codec.encode(BurstStop(id, "nothing", "eve", "b-none")), 1.0)

    def rubbish(self) -> None:
        """Send mutants of every message on the keys of a machine, for some seconds."""
        id, keys, examples = self.rng.choice(self.testbed.ids), Keys("soak"), [data for _, data in EXAMPLES]
        with self._noted("rubbish sent", (id,)), suppress(AfdsvcError), self._stranger() as stranger:
            until = time.monotonic() + self.rng.uniform(2, 6)
            while time.monotonic() < until:
                data = mutate_bytes(self.rng.choice(examples), self.rng.choice(examples), self.rng)
                for key in (keys.event(id), keys.description(id), keys.block(id), keys.lease(id)):
                    stranger.publish(key, data)
                with suppress(AfdsvcError):
                    stranger.ask(keys.burst(id), data, 1.0)
                time.sleep(0.01)
