"""A recording played back as a machine that can be watched but not excited."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from afdsvc.api.clock import Clock
from afdsvc.api.port import PortStatus
from afdsvc.api.signals import Block, Channel, Trace
from afdsvc.errors import BadInput


class Replay:
    """A `Port` over blocks that exist already, at the pace of their own time or as fast as the clock lets them.

    It has no ``arm``: a replay cannot be driven, and a type checker says so.
    """

    def __init__(self, blocks: Iterable[Block], clock: Clock) -> None:
        self._blocks: Iterator[Block] = iter(blocks)
        self._clock = clock
        first = next(self._blocks, None)
        if first is None:
            raise BadInput("there is nothing to replay: the recording holds no samples")
        self._next: Block | None = first
        self._channels, self._dt = first.channels, first.dt
        self._start: float | None = None
        self._first_k = first.k0
        self._samples = 0

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of every block."""
        return self._channels

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        return self._dt

    def read(self) -> Block | None:
        """Return the next block when its last sample is due; None at the end."""
        block = self._next
        if block is None:
            return None
        if self._start is None:
            self._start = self._clock.monotonic()
        self._clock.sleep_until(self._start + (block.k0 + len(block) - self._first_k) * block.dt)
        self._samples += len(block)
        self._next = next(self._blocks, None)
        return block

    def status(self) -> PortStatus:
        """Return the counters; a replay is never late."""
        return PortStatus(self._samples, 0, 1.0)

    def close(self) -> None:
        """End the replay."""
        self._next = None


def blocks_of(trace: Trace, machine: str, session: str, start_ns: int, size: int = 250) -> Iterator[Block]:
    """Yield a trace as blocks of ``size`` samples (the last may be shorter); values are passed on bit for bit."""
    for seq, k in enumerate(range(0, len(trace), size)):
        stamp = start_ns + round(k * trace.dt * 1e9)
        yield Block(machine, session, seq, k, trace.dt, stamp, trace.channels, trace.values[k : k + size])
