"""What one machine says, made once and sent many times: a closed loop in its noise, and what a burst adds to it.

The loop is linear, so the answer to a burst is added to the noise; the noise is periodic, so a machine can go on for ever.
A block is a header of some sixty bytes and samples that were encoded beforehand: a load generator of one core can be a
hundred machines.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.signals import Block
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned
from afdsvc.files.site import Site
from afdsvc.hal import control_sample
from afdsvc.plugins.manager import load
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.block_codec import encode_block

LENGTH = 250  # samples in a block
SECONDS = 20  # after which the noise comes again


def loop(machine: Commissioned, alpha: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return u, y, alpha, beta (n, 8) of the closed loop from rest."""
    assert machine.controller is not None
    assert machine.limits is not None
    control_sample.compile_loops()
    G, K = control_sample.contiguous_system(machine.plant), control_sample.contiguous_system(machine.controller.interconnection)
    n, m, p = len(alpha), machine.plant.inputs, machine.plant.outputs
    u, y, beta, limits = np.empty((n, m)), np.empty((n, p)), np.empty((n, p)), machine.limits
    control_sample.run_closed_loop(
        G.A, G.B, G.C, np.zeros(G.order), K.A, K.B, K.C, K.D, np.zeros(K.order), *control_sample.no_q(m, p),
        np.ascontiguousarray(alpha), np.zeros((n, m)), np.ascontiguousarray(noise), False, limits.output, limits.input, np.zeros(m), u, y, beta,
    )  # fmt: skip
    return np.hstack([u, y, alpha, beta])


@dataclass
class Signals:
    """The samples of a machine, ready to be sent; the answers to bursts are computed once for each shape of burst."""

    machine: Commissioned
    seed: int = 0
    _answers: dict[bytes, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        dt, n = self.machine.plant.dt, round(SECONDS / self.machine.plant.dt)
        assert self.machine.output_cov is not None
        sd = np.linalg.cholesky(self.machine.output_cov)
        noise = np.random.default_rng(self.seed).standard_normal((n, self.machine.plant.outputs)) @ sd.T
        twice = loop(self.machine, np.zeros((2 * n, self.machine.plant.inputs)), np.vstack([noise, noise]))
        self.quiet, self.dt = twice[n:].reshape(n // LENGTH, LENGTH, -1), dt
        self.bodies = [self.body(values) for values in self.quiet]

    def body(self, values: np.ndarray) -> bytes:
        """Return the encoded samples without their header."""
        block = Block("m", "s", 1, 1, self.dt, 1, self.machine.channels, np.ascontiguousarray(values))
        data = encode_block(block)
        header = pb.Block(machine="m", session="s", seq=1, k0=1, dt=self.dt)
        header.timestamp.nanos = 1
        return data[header.ByteSize() :]

    def answer(self, burst: Burst) -> np.ndarray:
        """Return what a burst adds, (blocks, samples, channels); the last ones are its decay."""
        played = burst.play(self.dt)
        key = played.tobytes()
        if key not in self._answers:
            n = (len(played) // LENGTH + 10) * LENGTH
            alpha = np.zeros((n, played.shape[1]))
            alpha[: len(played)] = played
            self._answers[key] = loop(self.machine, alpha, np.zeros((n, self.machine.plant.outputs))).reshape(n // LENGTH, LENGTH, -1)
        return self._answers[key]


@dataclass
class Talker:
    """One machine among many, each somewhere else in the noise. ``next(t_ns)`` returns its next block as bytes."""

    id: str
    session: str
    signals: Signals
    at: int = 0
    seq: int = 0
    burst: Burst | None = None
    began: int = 0

    def next(self, t_ns: int) -> bytes:
        """Return the block that begins at this time."""
        i = (self.at + self.seq) % len(self.signals.bodies)
        playing, body = "", self.signals.bodies[i]
        if self.burst is not None:
            answer, n = self.signals.answer(self.burst), self.seq - self.began
            if n < len(answer):
                playing = self.burst.name if n * LENGTH < self.burst.samples else ""
                body = self.signals.body(self.signals.quiet[i] + answer[n])
            else:
                self.burst = None
        header = pb.Block(machine=self.id, session=self.session, seq=self.seq, k0=self.seq * LENGTH, dt=self.signals.dt, burst=playing)
        header.timestamp.seconds, header.timestamp.nanos = divmod(t_ns, 10**9)
        self.seq += 1
        return header.SerializeToString() + body

    def play(self, burst: Burst) -> None:
        """Begin a burst with the next block."""
        whole = LENGTH * -(-burst.samples // LENGTH)
        assert whole == burst.samples, "expected a burst of whole blocks"
        self.burst, self.began = burst, self.seq


def commissioned(site: Site) -> Commissioned:
    """Return the parts of the first machine of a site: all are alike."""
    return commissioning.commission(site.machines[0], load())


def site_text(machines: int, port: int, folder: str, every: float = 60.0) -> str:
    """Return a site of so many gas bearings, each recorded, a burst of 2 s a minute (spread) on each."""
    text = f"""site = "load"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
cache_blocks = 200
[recording]
folder = "{folder}"
"""
    for i in range(machines):
        first = 4 + every * i / machines
        text += f"""
[[machines]]
id = "m{i + 1}"
plant = "gas_bearing"
bursts = {{every_seconds = {every}, first_after_seconds = {first:.2f}, seconds = 2.0}}
"""
    return text

