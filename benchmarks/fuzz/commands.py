"""Random sequences of commands and readings against a rig agent: plant inputs and alpha never beyond their limits, always finite.

    nice -n 10 python benchmarks/fuzz/commands.py --sequences 100000

The agent is the one that runs on a rig, with the nominal gas bearing as hardware and a clock that does not wait. Between two samples anything may
come, as threads of the network would leave it: bursts (right, too large, with NaN, for others, stale, of every length), stops and leases (right,
for others, endless, negative), Qs (small, huge, unstable, not finite), rubbish, a service that vanishes and comes back; sensors return NaN, infinity, 1.7e308 or values beyond the output's
limit. Eight make a sequence; the machine goes on from one to the next, and is started anew after an emergency stop. Exit 1 when anything
was found.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from numba import njit

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.retuning import DiagnosedFault, Tuning
from afdsvc.app import commissioning
from afdsvc.errors import AfdsvcError
from afdsvc.files.site import MachineSection, PluginSection
from afdsvc.hal.agent import RigAgent
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.hal.control_sample import contiguous_system
from afdsvc.hal.excitation import LONGEST_FADE
from afdsvc.hal.hardware import DrivenRig
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, Lease, RetuneRequest, RigDescription
from benchmarks.support.mutation import mutate_bytes

KEYS, LENGTH, BLOCK = Keys("t"), 8, 50
WRONG = (float("nan"), float("inf"), -float("inf"), 1.7e308, -1.7e308, 1e154, 1e5, -1e5)


@njit
def advance(A, B, C, x, u):  # type: ignore[no-untyped-def]
    """Return the plant's next state and its outputs."""
    x = A @ x + B @ u
    return x, C @ x


@njit
def within(u, limit):  # type: ignore[no-untyped-def]
    """Return whether all values are finite and within their limits."""
    for value, bound in zip(u, limit):  # noqa: B905 - compiled
        if not abs(value) <= bound:
            return False
    return True


class Wire:
    """A transport that hands everything to the checks, and takes what the agent listens to."""

    def __init__(self, check: Callable[[str, bytes], None]) -> None:
        self.publish, self.heard = check, dict[str, Any]()

    def alive(self, pattern: str) -> list[str]:
        """Nobody else is there."""
        return []

    def announce(self, key: str) -> None:
        """Nobody listens."""

    def serve(self, key: str, answer: Any, threads: int = 0) -> None:
        """Note who answers."""
        self.heard[key] = answer

    def subscribe(self, key: str, receive: Any, missed: bool = True) -> None:
        """Note who listens."""
        self.heard[key] = receive

    def watch(self, key: str, changed: Any) -> None:
        """Note who watches."""
        self.heard[key] = changed


class Attack:
    """The hardware of the machine, which does something between samples, and the checks of all that leaves the agent."""

    def __init__(self, machine: Any, rng: Random, sequences: int) -> None:
        self.machine, self.rng, self.left = machine, rng, sequences * LENGTH
        self.G, self.found, self.counts = contiguous_system(machine.plant), list[str](), Counter[str]()
        self.clock, self.n = FastClock(), 0
        self.agent: RigAgent | None = None

    def run(self) -> None:
        """Run agents until all sequences are through."""
        while self.left > 0:
            self.x, self.u = np.zeros(self.G.order), np.zeros(2)
            self.wrong, self.next = None, 30
            settings = LoopSettings("m", f"s{self.n}", block=BLOCK, slice=10)
            port = DrivenRig(self, self.machine.controller.interconnection, self.machine.channels, self.machine.limits, settings, self.clock)
            description = RigDescription("m", f"s{self.n}", 1, port.dt, port.channels, self.machine.limits)
            self.line = Wire(self.check)
            self.agent = RigAgent(KEYS, description, port, self.line, self.clock, patient=True)
            self.agent.run()

    # -------------------------------------------------------------------------------------------------------- the hardware

    def open(self) -> None:
        """Begin."""

    def read(self) -> Any:
        """Advance the plant, and now and then do something bad."""
        self.n += 1
        self.x, y = advance(self.G.A, self.G.B, self.G.C, self.x, self.u)
        self.clock.sleep_until(self.clock.monotonic() + self.G.dt)
        self.next -= 1
        if self.next <= 0:
            self.next = self.rng.choice((self.rng.randrange(1, 8), self.rng.randrange(8, 40)))
            self.act()
        if self.wrong is not None:
            y[self.rng.randrange(2)], self.wrong = self.wrong, None
        return y

    def write(self, u: Any) -> None:
        """Take the plant inputs, which must be finite and within their limits."""
        if not within(u, self.machine.limits.input):
            self.found.append(f"sample {self.n}: plant inputs {u}")
        self.u = u.copy()

    def rest(self) -> None:
        """Come to rest."""

    def close(self) -> None:
        """End."""

    # ------------------------------------------------------------------------------------------------------------ the checks

    def check(self, key: str, payload: bytes) -> None:
        """Check a block that leaves the agent."""
        if not key.endswith("/block"):
            return
        block, limits = codec.decode_block(payload), self.machine.limits
        u, y, alpha = (block.role(role) for role in ("u", "y", "alpha"))
        if not (np.isfinite(u).all() and np.isfinite(alpha).all()):
            self.found.append(f"block {block.seq}: not finite")
        if (np.abs(u) > limits.input).any() or (np.abs(alpha) > limits.alpha).any():
            self.found.append(f"block {block.seq}: beyond a limit")
        beyond = ~(np.abs(y) <= limits.output).all(axis=1)
        if alpha[beyond].any():
            self.found.append(f"block {block.seq}: alpha plays while an output is beyond its limit or missing")
        if alpha.any() and not block.burst:
            self.found.append(f"block {block.seq}: alpha without a burst")
        self.counts["samples"] += len(block)
        self.counts["samples with alpha"] += int(alpha.any(axis=1).sum())
        self.counts["samples with a missing or excessive reading"] += int(beyond.sum())

    def after_lease(self) -> None:
        """Nothing may play longer after the lease than a fade and a block."""
        agent = self.agent
        assert agent is not None
        overdue = self.clock.monotonic() - agent._bursts.until  # noqa: SLF001
        playing = agent.port._excitation.playing  # noqa: SLF001
        if playing and overdue > LONGEST_FADE + 2 * BLOCK * agent.port.dt:
            self.found.append(f"sample {self.n}: a burst plays {overdue:.2f} s after its lease")

    # --------------------------------------------------------------------------------------------------------- what is done

    def act(self) -> None:
        """Do one of the things that can happen, and count it."""
        if self.left <= 0 or self.agent is None or KEYS.burst("m") not in self.line.heard:
            return
        self.left -= 1
        self.after_lease()
        if self.agent.emergency.is_set():
            self.agent.stopping.set()
        often = (*[self.burst] * 6, *[self.lease] * 6, self.reading, self.reading)
        acts = (*often, self.stop, self.rubbish, self.service, self.retune, self.restore)
        act = self.rng.choice(acts) if self.rng.random() > 5e-4 else self.emergency
        self.counts[act.__name__] += 1
        with suppress(AfdsvcError):
            act()
        if self.left <= 0:
            self.agent.stopping.set()

    def burst(self) -> None:
        """Ask for a burst, most of them such that they could be played."""
        rng, bounds = self.rng, self.machine.limits
        n = rng.choice((1, 200, 1000, 3000, 3000, 10**6))
        size = rng.choice((0.01, 0.02, 0.05, 0.1, 0.1, 0.2, 0.5, 1.0, 1.1, 1e9, float("inf"), float("nan")))
        line = Line(rng.choice((0, 0, 0, 1, 1, 1, 5, -1)), rng.uniform(1, 2e4), size * float(bounds.alpha[0]), rng.uniform(0, 6))
        burst = Burst(f"b{self.n}", 2, n, rng.choice((0, 1, n // 8, n // 8, n)), (line,)) if rng.random() < 0.7 else self.waveform(n)
        description, k = self.agent.description, self.agent._k  # noqa: SLF001
        request = BurstRequest(
            rng.choice(("m",) * 9 + ("other",)), burst, rng.choice((0.05, 0.5, 2.0, 2.0, 9.0, 1e9)), "test", self.clock.now_ns(),
            rng.choice((0, 0, 0, k + rng.randrange(500), 2**62)), rng.choice((description.session, description.session, "", "old")),
            rng.choice((0, k)),
        )  # fmt: skip
        self.watch_over()
        reply = codec.decode(BurstReply, self.line.heard[KEYS.burst("m")](codec.encode(request)))
        self.counts["bursts accepted"] += reply.accepted

    def waveform(self, n: int) -> Burst:
        """Return a burst of random samples."""
        n = min(n, 1000)
        samples = np.random.default_rng(self.n).uniform(-1, 1, (n, 2)) * self.machine.limits.alpha * self.rng.choice((0.2, 1.0, 1.0001))
        if self.rng.random() < 0.1:
            samples[self.rng.randrange(n)] = self.rng.choice(WRONG)
        return Burst(f"b{self.n}", 2, n, 0, (), samples)

    def watch_over(self) -> None:
        """The service is there again, most of the time."""
        if self.rng.random() < 0.9:
            self.line.heard[KEYS.service_alive()](KEYS.service_alive(), True)

    def lease(self) -> None:
        """Renew what plays, or something else."""
        playing = self.rng.choice((self.agent._bursts.name, self.agent._bursts.name, self.agent._qs.name)) or "none"  # noqa: SLF001
        lease = Lease(self.rng.choice(("m", "m", "m", "other")), self.rng.choice((playing, playing, "b-none")), self.rng.choice((0.01, 0.1, 2.0, 2.0, 10.0, 11.0, 1e300)))
        self.line.heard[KEYS.lease("m")]("", codec.encode(lease))

    def stop(self) -> None:
        """Stop what plays, or something else."""
        self.line.heard[KEYS.stop("m")](codec.encode(BurstStop(self.rng.choice(("m", "other")), "why", "eve", self.rng.choice(("", "b-none")))))

    def retune(self) -> None:
        """Ask for a Q: slow or fast, small or huge, unstable, not finite, or of another size."""
        rng, size = self.rng, self.rng.choice((1e-3, 1.0, 1e6, 1e300, float("nan")))
        pole, outputs = rng.choice((0.5, 0.99, 0.99, 1.01, float("inf"))), rng.choice((2, 2, 2, 3))
        Q = StateSpace(np.diag([pole, pole]), np.ones((2, outputs)), size * np.ones((2, 2)), size * np.ones((2, outputs)), self.G.dt)
        tuning = Tuning(Q, rng.choice((0.0, 0.01, 1.0)), rng.choice((0.0, 0.01, 1.0)), None)
        request = RetuneRequest(
            rng.choice(("m", "m", "other")), f"q{self.n}", tuning, DiagnosedFault("any", -0.1, 0.0), rng.choice((0.05, 2.0, 9.0, 1e9)), "eve",
            self.clock.now_ns(), self.agent.description.session, self.agent._k, "",  # noqa: SLF001
        )  # fmt: skip
        self.watch_over()
        reply = codec.decode(BurstReply, self.line.heard[KEYS.retune("m")](codec.encode(request)))
        self.counts["Qs accepted"] += reply.accepted

    def restore(self) -> None:
        """Take Q back, or something else."""
        self.line.heard[KEYS.restore("m")](codec.encode(BurstStop(self.rng.choice(("m", "other")), "why", "eve", self.rng.choice(("", "none")))))

    def rubbish(self) -> None:
        """Send a mutant of a message to one who listens."""
        good = codec.encode(Lease("m", "b", 2.0))
        data = mutate_bytes(good, codec.encode(BurstStop("m", "why", "eve", "")), self.rng)
        key = self.rng.choice((KEYS.burst("m"), KEYS.stop("m"), KEYS.lease("m")))
        self.line.heard[key](*(("", data) if key == KEYS.lease("m") else (data,)))

    def service(self) -> None:
        """The service vanishes or appears."""
        self.line.heard[KEYS.service_alive()](KEYS.service_alive(), self.rng.random() < 0.6)

    def reading(self) -> None:
        """A sensor returns what no sensor should, or the output is beyond its limit."""
        limit = float(self.machine.limits.output[0])
        self.wrong = self.rng.choice((*WRONG, 1.0001 * limit, 3 * limit, -999 * limit))

    def emergency(self) -> None:
        """The emergency stop, and a new start some time after."""
        assert self.agent is not None
        self.agent.emergency.set()


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    driver = {"kind": "simulator", "real_time": False}
    config = MachineSection(id="m", plant="gas_bearing", controller=PluginSection(kind="lqg"), driver=driver)
    attack, began = Attack(commissioning.commission(config, load()), Random(asked.seed), asked.sequences), time.monotonic()
    attack.run()
    print(f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, seed {asked.seed}")
    print(f"{asked.sequences} sequences of {LENGTH} in {time.monotonic() - began:.0f} s: " + ", ".join(f"{k} {n}" for k, n in sorted(attack.counts.items())))
    print(f"{len(attack.found)} found")
    for sentence in attack.found[:20]:
        print("  !", sentence)
    return 1 if attack.found else 0


if __name__ == "__main__":
    sys.exit(main())
