"""New keys, certificates and revocations of a secured site are taken up by running processes; certificates that end are reported."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from afdsvc.api.clock import Clock
from afdsvc.errors import AfdsvcError
from afdsvc.files.site import Site
from afdsvc.transport.access_rules import access_of
from afdsvc.transport.certificates import NAMES, check_pair, ending, key_files
from afdsvc.transport.zenoh_session import Transport

log = logging.getLogger(__name__)
LOOK_SECONDS = 2.0
WAIT_SECONDS = 60.0  # for a burst to end, before a renewed certificate is taken up all the same
WARN_SECONDS = 86400.0


class KeyWatch:
    """Looks at the folder of keys in a thread of its own.

    The session of ``identity`` is opened anew with what has changed: its own certificate, the authority's, and which common names are
    obeyed. A burst is waited for, but not when something was revoked. ``busy()`` says whether a burst plays, ``tell(sentence)`` what was done.
    """

    def __init__(
        self, site: Site, identity: str, transport: Transport, clock: Clock, busy: Callable[[], bool], tell: Callable[[str], object]
    ) -> None:  # fmt: skip
        self._identity = identity
        assert site.transport.security is not None  # noqa: S101 - only a secured site has keys
        self._site, self._security, self._transport, self._clock, self._busy, self._tell = site, site.transport.security, transport, clock, busy, tell
        self._seen, self._since, self._warned, self._failed = self._look(), float("-inf"), float("-inf"), ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="keys", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._stop.set()
        self._thread.join(2)

    def _work(self) -> None:
        while not self._stop.wait(LOOK_SECONDS):
            try:
                self._warn()
                self._take_up()
                self._failed = ""
            except AfdsvcError as error:
                if self._failed != (why := str(error)):
                    log.error("new keys cannot be taken up: %s", why)
                self._failed = why
            except Exception:
                log.exception("looking at the keys failed")

    def _look(self) -> dict[Path, tuple[int, int]]:
        """Return what can change the session: inode and time of the files."""
        paths = [self._security.keys / name for name in ("ca.pem", f"{self._identity}.pem", f"{self._identity}.key", NAMES)]
        return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in paths if path.exists()}

    def _take_up(self) -> None:
        now, found = self._clock.monotonic(), self._look()
        if found == self._seen:
            self._since = now
            return
        revoked = found.get(self._security.keys / NAMES) != self._seen.get(self._security.keys / NAMES)
        if self._busy() and not revoked and now - self._since < WAIT_SECONDS:
            return
        check_pair(key_files(self._security, self._identity))
        self._transport.reopen(access_of(self._site, self._identity))
        self._seen = found
        self._tell("revoked certificates and new keys are taken up" if revoked else "new keys are taken up")

    def _warn(self) -> None:
        if self._clock.monotonic() - self._warned > WARN_SECONDS:
            self._warned = self._clock.monotonic()
            for sentence in ending(self._security):
                log.warning("%s", sentence)
