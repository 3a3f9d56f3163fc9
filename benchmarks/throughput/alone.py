"""What the parts of a service would hold alone on one core: zenoh (receive, count), MCAP (the same files), numpy (the arrays)."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import LENGTH, Signals, Talker, commissioned, site_text

from afdsvc.api.signals import of_role, residual_block
from afdsvc.app.pipelines import pipeline_of
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.codec import decode_block, encode_block
from afdsvc.wire.keys import Keys

PORT = 17447


def talker() -> Talker:
    """Return one machine."""
    return Talker("m1", "s1", Signals(commissioned(parse_site(site_text(1, PORT, "x"), "benchmark"))))


def zenoh_alone(n: int = 30_000) -> float:
    """Return blocks a second that arrive through the transport of the service when they are only counted."""
    site, seen = parse_site(site_text(1, PORT, "x"), "benchmark"), 0

    def count(_key: str, _payload: bytes) -> None:
        nonlocal seen
        seen += 1

    with Transport(site.transport, True) as hub:
        hub.subscribe(Keys("load").blocks(), count)
        sender = subprocess.Popen([sys.executable, __file__, str(n)])
        while not seen and sender.poll() is None:
            time.sleep(0.001)
        start, first = time.perf_counter(), seen
        while seen < n and sender.poll() is None:
            time.sleep(0.001)
        rate = (seen - first) / (time.perf_counter() - start)
        sender.wait()
    return rate


def _send(n: int) -> None:
    site, machine = parse_site(site_text(1, PORT, "x"), "benchmark"), talker()
    made = [machine.next(10**18 + i * 50_000_000) for i in range(1000)]
    with Transport(site.transport, False) as line:
        time.sleep(0.3)
        for i in range(n):
            line.publish(Keys("load").block("m1"), made[i % 1000])
        time.sleep(1.0)


def mcap_alone(n: int = 2000) -> float:
    """Return blocks a second of one thread that only writes what a machine leaves: block, preview, residual."""
    machine = talker()
    data = [machine.next(10**18 + i * 50_000_000) for i in range(n)]
    made = [decode_block(d) for d in data]
    outputs = of_role(made[0].channels, "y")
    residuals = [residual_block(b, b.values[:, outputs]) for b in made]
    encoded = [encode_block(r) for r in residuals]
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(RecordingSettings(Path(folder) / "m.mcap"))
        start = time.perf_counter()
        for i in range(n):
            recorder.block(data[i], made[i])
            recorder.residual(encoded[i], residuals[i])
        recorder.close()
        return n / (time.perf_counter() - start)


def numpy_alone(n: int = 2000) -> float:
    """Return blocks a second of the least arithmetic there is: residual and its lines by two matrix products, no state kept.

    The residual filter is applied as one dense matrix from the block's y and u to its r, then r is projected on the sines and
    cosines of a burst of two lines.
    """
    site, machine = parse_site(site_text(1, PORT, "x"), "benchmark"), talker()
    problem = pipeline_of(commissioned(site), load()).problem  # type: ignore[union-attr]
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
    arrays = [decode_block(machine.next(10**18 + i * 50_000_000)).values for i in range(n)]
    start = time.perf_counter()
    for values in arrays:
        r = (toeplitz @ np.ascontiguousarray(values[:, columns]).reshape(-1)).reshape(LENGTH, outputs)
        lines.T @ r
    return n / (time.perf_counter() - start)


if __name__ == "__main__":
    _send(int(sys.argv[1]))
