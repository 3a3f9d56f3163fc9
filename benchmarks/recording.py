"""Throughput of codec, recorder, reader and review: ``python benchmarks/recording.py`` (half a minute, one core).

One machine is 5 kHz with ten signals in blocks of 250. Figures depend on the computer; ratios less so.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.present.rerun.log import ReviewLog
from afdsvc.wire.codec import decode_block, encode_block

SECONDS, RATE, LENGTH = 20, 5000, 250
CHANNELS = tuple(Channel(f"{role}_{i}", "um") for role in ("u", "y", "alpha", "beta", "aux") for i in (1, 2))


def machine_blocks() -> list[Block]:
    """Return the blocks of one machine, values with four decimals as converters give them."""
    values = np.round(np.random.default_rng(0).normal(size=(SECONDS * RATE, len(CHANNELS))), 4)
    return [
        Block("m1", "s1", seq, seq * LENGTH, 1 / RATE, 10**18 + seq * 50_000_000, CHANNELS, part)
        for seq, part in enumerate(np.split(values, SECONDS * RATE // LENGTH))
    ]


def seconds(work: Callable[[], object], repeat: int = 3) -> float:
    """Return the shortest of several runs."""
    best = float("inf")
    for _ in range(repeat):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best


def tell(what: str, taken: float) -> None:
    """Print time per block and how many machines one core keeps up with."""
    per_block = taken / (SECONDS * RATE / LENGTH) * 1e6
    print(f"{what:34s} {per_block:8.1f} us/block {per_block / LENGTH * 1e3:7.0f} ns/sample {SECONDS / taken:7.0f} machines")


def main() -> None:
    """Measure and print."""
    blocks = machine_blocks()
    wire = [encode_block(b) for b in blocks]
    tell("encode", seconds(lambda: [encode_block(b) for b in blocks]))
    tell("decode", seconds(lambda: [decode_block(d) for d in wire]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "b.mcap"
        for hertz in (0.0, 100.0):
            tell(f"record, preview {hertz:.0f} Hz", seconds(lambda h=hertz: record(path, blocks, wire, h)))
        raw = SECONDS * RATE * len(CHANNELS) * 8
        print(f"{'size of the recording':34s} {path.stat().st_size / raw * 100:7.0f} % of the raw doubles")
        tell("read into a trace", seconds(lambda: Recording(path).traces()))
        for burst in ("", "b"):
            shown = [replace(b, burst=burst) for b in blocks]
            what = "review, in bursts" if burst else "review, quiet"
            tell(what, seconds(lambda s=shown: review(Path(folder) / "b.rrd", s)))


def record(path: Path, blocks: list[Block], wire: list[bytes], hertz: float) -> None:
    """Record all blocks into a new file."""
    recorder = Recorder(RecordingSettings(path, preview_hertz=hertz, overwrite=True))
    for block, data in zip(blocks, wire, strict=True):
        recorder.block(data, block)
    recorder.close()


def review(path: Path, blocks: list[Block]) -> None:
    """Log all blocks into a Rerun file."""
    log = ReviewLog(path)
    for block in blocks:
        log.block(block)
    log.close()


if __name__ == "__main__":
    main()
