"""The lease of a burst or a Q: without renewal by the requester neither starts or continues."""

from __future__ import annotations

from dataclasses import dataclass

from afdsvc.api.clock import Clock


@dataclass
class LeaseTimer:
    """The asker's word that it is still there; a burst fades out, and a Q goes, when that word has expired or the service is gone."""

    clock: Clock
    until: float = float("-inf")
    service_gone: bool = False

    def renew(self, seconds: float) -> None:
        """Extend the lease from now on."""
        self.until = self.clock.monotonic() + seconds

    def expired(self) -> str:
        """Return why it must end, "" while the lease holds."""
        if self.service_gone:
            return "the service vanished"
        return "the lease expired: no renewal from the service" if self.clock.monotonic() > self.until else ""
