"""What the parts of a service would hold alone on one core, in blocks for each second of processor time.

    python benchmarks/throughput/alone.py zenoh|mcap|judge|numpy [BLOCKS]

Each part runs in a process of its own, so that nothing else is counted. `run.py` starts them with one thread for linear algebra.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from machine import LENGTH, Signals, Talker, commissioned, site_text

from afdsvc.api.signals import of_role, residual_block
from afdsvc.app.pipelines import pipeline_of
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import Site, parse_site
from afdsvc.plugins.manager import load
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.codec import decode_block, encode_block
from afdsvc.wire.keys import Keys

PORT = 17447


def machine_site() -> Site:
    """Return a site of one machine."""
    return parse_site(site_text(1, PORT, "x"), "benchmark")


def talker() -> Talker:
    """Return one machine."""
    return Talker("m1", "s1", Signals(commissioned(machine_site())))


def blocks(n: int) -> list[bytes]:
    """Return the first blocks of a machine, encoded."""
    machine = talker()
    return [machine.next(10**18 + i * 50_000_000) for i in range(n)]


def rate(work: Callable[[Any], object], items: list[Any], group: int = 20) -> float:
    """Return items a second of processor time, in the fastest group of equal size: what others do to the caches is left out."""
    least = float("inf")
    for i in range(0, len(items) - group + 1, group):
        start = time.process_time()
        for item in items[i : i + group]:
            work(item)
        least = min(least, time.process_time() - start)
    return group / least


def zenoh_alone(n: int = 30_000) -> float:
    """Return blocks a second that arrive through the transport of the service when they are only counted."""
    seen, start = 0, 0.0

    def count(_key: str, _payload: bytes) -> None:
        nonlocal seen, start
        start = start or time.process_time()
        seen += 1

    with Transport(machine_site().transport, True) as hub:
        hub.subscribe(Keys("load").blocks(), count)
        sender = subprocess.Popen([sys.executable, __file__, "send", str(n)])
        while seen < n and sender.poll() is None:
            time.sleep(0.01)
        found = seen / (time.process_time() - start)
        sender.wait()
    return found


def send(n: int) -> None:
    """Send blocks as fast as they go, to `zenoh_alone`."""
    made = blocks(1000)
    with Transport(machine_site().transport, False) as line:
        time.sleep(0.3)
        for i in range(n):
            line.publish(Keys("load").block("m1"), made[i % 1000])
        time.sleep(1.0)


def mcap_alone(n: int = 2000) -> float:
    """Return blocks a second of one thread that only writes what a machine leaves: block, preview, residual."""
    data = blocks(n)
    made = [decode_block(d) for d in data]
    outputs = of_role(made[0].channels, "y")
    residuals = [residual_block(b, b.values[:, outputs]) for b in made]
    encoded = [encode_block(r) for r in residuals]
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(RecordingSettings(Path(folder) / "m.mcap"))
        start = time.process_time()
        for i in range(n):
            recorder.block(data[i], made[i])
            recorder.residual(encoded[i], residuals[i])
        recorder.close()
        return n / (time.process_time() - start)


def judge_alone(n: int = 900) -> float:
    """Return quiet blocks a second that are decoded and judged by all detectors of a machine; no transport, no files."""
    pipeline = pipeline_of(commissioned(machine_site()), load())

    def judge(data: bytes) -> None:
        pipeline.step(decode_block(data))

    data = blocks(n)
    for first in data[:100]:
        judge(first)
    return rate(judge, data[100:])


def numpy_alone(n: int = 1000) -> float:
    """Return blocks a second of the least arithmetic there is: residual and its lines by two matrix products, no state kept.

    The residual filter is applied as one dense matrix from the block's y and u to its r, then r is projected on the sines and
    cosines of a burst of two lines.
    """
    machine = talker()
    problem = pipeline_of(commissioned(machine_site()), load()).problem  # type: ignore[union-attr]
    system, columns = problem.innovations, of_role(machine.signals.machine.channels, "y") + of_role(machine.signals.machine.channels, "u")
    inputs, outputs = system.inputs, system.outputs
    markov, x = [system.D], system.B
    for _ in range(LENGTH - 1):
        markov.append(system.C @ x)
        x = system.A @ x
    toeplitz = np.zeros((LENGTH * outputs, LENGTH * inputs))
    for i in range(LENGTH):
        for j in range(i + 1):
            toeplitz[i * outputs : (i + 1) * outputs, j * inputs : (j + 1) * inputs] = markov[i - j]
    t = problem.plant.dt * np.arange(LENGTH)
    lines = np.column_stack([f(w * t) for w in (300.0, 900.0) for f in (np.sin, np.cos)])

    def filtered(values: np.ndarray) -> None:
        r = (toeplitz @ np.ascontiguousarray(values[:, columns]).reshape(-1)).reshape(LENGTH, outputs)
        lines.T @ r

    return rate(filtered, [decode_block(d).values for d in blocks(n)])


PARTS = {"zenoh": zenoh_alone, "mcap": mcap_alone, "judge": judge_alone, "numpy": numpy_alone}

if __name__ == "__main__":
    if sys.argv[1] == "send":
        send(int(sys.argv[2]))
    else:
        print(PARTS[sys.argv[1]](*map(int, sys.argv[2:])))
