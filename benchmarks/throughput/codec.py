"""Encoding a block of 250 samples of ten channels, against protobuf filling repeated doubles, in one run.

    python benchmarks/throughput/codec.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from afdsvc.api.signals import Block, Channel
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.codec import encode_block

CHANNELS = tuple(Channel(f"y_{i}") for i in range(10))


def by_protobuf(values: np.ndarray) -> bytes:
    """Return the signals of a block as protobuf's own Python writes them."""
    signals = [pb.Signal(name=c.name, unit=c.unit, values=v.tolist()) for c, v in zip(CHANNELS, values.T, strict=True)]
    return bytes(pb.Block(machine="m1", session="s1", dt=2e-4, signals=signals).SerializeToString())


def seconds(work: Callable[[], object]) -> float:
    """Return the best time of one call, in processor time."""
    best = np.inf
    for _ in range(20):
        start = time.process_time()
        for _ in range(50):
            work()
        best = min(best, (time.process_time() - start) / 50)
    return float(best)


def main() -> None:
    """Print both times and their ratio."""
    values = np.random.default_rng(0).normal(size=(250, len(CHANNELS)))
    block = Block(machine="m1", session="s1", seq=7, k0=1750, dt=2e-4, t0_ns=10**18, channels=CHANNELS, values=values)
    ours, theirs = seconds(lambda: encode_block(block)), seconds(lambda: by_protobuf(values))
    print(f"{1e6 * ours:.0f} us a block, protobuf's repeated doubles {1e6 * theirs:.0f} us: {theirs / ours:.1f} times as fast")


if __name__ == "__main__":
    main()
