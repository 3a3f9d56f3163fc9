"""The watchdog: the longest waits of the service's parts, measured where they happen and reported."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping

from afdsvc.api.clock import Clock

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
