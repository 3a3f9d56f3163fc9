"""Freshness of requests: each is obeyed once, and not long after it was made."""

from __future__ import annotations

import hashlib
import threading

from afdsvc.api.clock import Clock
from afdsvc.errors import Refused

FRESH_SECONDS = 300.0
MOST_REMEMBERED = 10_000


class Freshness:
    """Remembers the requests of the last while by their digests; any thread may call."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self._seen, self._lock = clock, dict[bytes, float](), threading.Lock()

    def refuse_repeated(self, payload: bytes) -> None:
        """Raise `Refused` for a request that has come before; honest ones differ in time and nonce.

        ``payload`` is the request encoded anew: bytes that no reader looks at make no new request of an old one.
        """
        digest, now = hashlib.sha256(payload).digest(), self._clock.monotonic()
        with self._lock:
            while self._seen and (len(self._seen) >= MOST_REMEMBERED or next(iter(self._seen.values())) < now - 2 * FRESH_SECONDS):
                del self._seen[next(iter(self._seen))]
            if digest in self._seen:
                raise Refused("the very same request has come before; each is obeyed once")
            self._seen[digest] = now

    def refuse_old(self, t_ns: int) -> None:
        """Raise `Refused` for a request that was made too long before or after now by the clocks of both computers."""
        age = (self._clock.now_ns() - t_ns) / 1e9
        if not abs(age) <= FRESH_SECONDS:
            when = f"{abs(age):.0f} s {'ago' if age > 0 else 'ahead'}"
            raise Refused(f"the request was made {when} by its time stamp; at most {FRESH_SECONDS:g} s are accepted: are both clocks right?")
