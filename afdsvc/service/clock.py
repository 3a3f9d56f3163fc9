"""Clocks: real time, and one that advances on request."""

from __future__ import annotations

import time


class RealClock:
    """Wall and monotonic time of this computer."""

    def now_ns(self) -> int:
        """Return Unix time in nanoseconds."""
        return time.time_ns()

    def monotonic(self) -> float:
        """Return seconds that never go back."""
        return time.perf_counter()

    def sleep_until(self, deadline: float) -> None:
        """Wait until the deadline of `monotonic`."""
        rest = deadline - time.perf_counter()
        if rest > 0:
            time.sleep(rest)


class FastClock:
    """A clock that jumps to every deadline: simulation and replay as fast as they go, with the stamps of real time."""

    def __init__(self, start_ns: int = 1_700_000_000_000_000_000) -> None:
        self._start_ns = start_ns
        self._seconds = 0.0

    def now_ns(self) -> int:
        """Return the start plus the seconds jumped so far."""
        return self._start_ns + round(self._seconds * 1e9)

    def monotonic(self) -> float:
        """Return the seconds jumped so far."""
        return self._seconds

    def sleep_until(self, deadline: float) -> None:
        """Jump to the deadline."""
        self._seconds = max(self._seconds, deadline)
