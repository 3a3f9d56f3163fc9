"""The clock protocol: time is passed in as an argument."""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """What the doing rooms know of time; tests and fast simulation bring their own."""

    def now_ns(self) -> int:
        """Return Unix time in nanoseconds, for stamps."""
        ...

    def monotonic(self) -> float:
        """Return seconds that never go back, for deadlines."""
        ...

    def sleep_until(self, deadline: float) -> None:
        """Wait until `monotonic` reaches the deadline; return at once when it has passed."""
        ...
