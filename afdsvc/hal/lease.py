"""Leases: what the service asked of a rig, a burst or a Q, starts and goes on only while the service renews its word."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

from afdsvc.api.clock import Clock
from afdsvc.errors import Refused

T = TypeVar("T")
LONGEST_SECONDS = 10.0  # a longer lease would outlive whoever gave it


class Grant(Generic[T]):
    """One request at a time: reserved while it is checked, given, taken by the control thread, and ended.

    ``what`` says what is granted, ``busy`` why a second request is refused while one acts. Any thread may call.
    """

    def __init__(self, clock: Clock, what: str, busy: str) -> None:
        self._clock, self._what, self._busy, self._lock = clock, what, busy, threading.Lock()
        self._halt = self.name = ""  # why it must end; what acts, or is about to
        self.pending: T | None = None
        self.until = float("-inf")
        self.service_gone = False

    def reserve(self, name: str, lease: float) -> None:
        """Reserve for a request that is checked next; raises `Refused` while another acts or the request is not supervised."""
        if self.service_gone:
            raise Refused(f"the service is not connected; {self._what} would not be supervised")
        refuse_long(lease)
        with self._lock:
            if self.name:
                raise Refused(self._busy.format(self.name))
            self.name, self._halt = name, ""

    def give(self, request: T, lease: float) -> None:
        """Leave the request that was checked to the control thread; its lease [s] runs from now on."""
        with self._lock:
            self.until, self.pending = self._clock.monotonic() + lease, request

    def take(self) -> T | None:
        """Return the request that waits, once."""
        with self._lock:
            request, self.pending = self.pending, None
            return request

    def end(self) -> None:
        """Nothing acts any more."""
        with self._lock:
            self.name, self.pending = "", None

    def stop(self, name: str, reason: str) -> str:
        """End what acts when it has this name, or whatever acts for ""; returns its name, "" when there is no such."""
        with self._lock:
            if self.name and name in ("", self.name):
                self._halt = reason
                return self.name
            return ""

    def renew(self, name: str, seconds: float) -> None:
        """Extend the lease of what acts from now on, when it has this name."""
        if name == self.name:
            self.until = self._clock.monotonic() + seconds

    def reason_to_end(self) -> str:
        """Return why it must end, "" while it may go on."""
        if self._halt or not (self.service_gone or self._clock.monotonic() > self.until):
            return self._halt
        return "the service vanished" if self.service_gone else "the lease expired: no renewal from the service"


def refuse_long(lease: float) -> None:
    """Raise `Refused` for a lease [s] that would outlive whoever gave it."""
    if not lease <= LONGEST_SECONDS:
        raise Refused(f"the lease is {lease:g} s; at most {LONGEST_SECONDS:g} s are accepted without renewal")
