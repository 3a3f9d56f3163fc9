"""Clocks, real and one that advances on request, and the watchdog that keeps the longest waits."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping

from afdsvc.api.clock import Clock


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


log = logging.getLogger(__name__)
LONGEST = {"leases": 1.0, "requests": 1.0, "bursts": 1.0, "judgement": 10.0}  # seconds; a longer wait is logged
WINDOW_SECONDS = 600.0


class Watchdog:
    """Keeps the longest waits [s] of the last one to two windows; any thread may call.

    ``leases``: between two renewals. ``requests``: from a person's request to its answer (a ticket counts). ``bursts``: between two looks
    at what is due. ``judgement``: from the arrival of a message until it is judged and passed on.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._now, self._before, self._since = dict.fromkeys(LONGEST, 0.0), dict[str, float](), clock.monotonic()

    def note(self, what: str, seconds: float) -> None:
        """Note a wait; one that is dangerous and the longest so far is logged."""
        with self._lock:
            self._turn()
            longest, self._now[what] = self._now[what], max(self._now[what], seconds)
        if seconds > max(1.25 * longest, LONGEST[what]):
            log.warning("%s waited %.1f s; expected at most %g s: is the computer overloaded?", what, seconds, LONGEST[what])

    def longest(self) -> Mapping[str, float]:
        """Return the longest waits by what waited."""
        with self._lock:
            self._turn()
            return {what: max(wait, self._before.get(what, 0.0)) for what, wait in self._now.items()}

    def _turn(self) -> None:
        if self._clock.monotonic() - self._since > WINDOW_SECONDS:
            self._before, self._now, self._since = self._now, dict.fromkeys(LONGEST, 0.0), self._clock.monotonic()
