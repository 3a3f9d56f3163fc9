"""The lease keeper: a process that does nothing but renew leases, on behalf of the service and only while the service is well.

In a process of Python no thread runs while another holds the interpreter, and on a computer that is overloaded the holder may itself be waiting
for a core. The keeper therefore shares neither interpreter nor session with the service. Several times a second it is sent the leases there
are; when nothing comes for `TRUST_SECONDS` it renews nothing, and when the service ends, so does it. This file is run as a script: what the keeper needs is zenoh alone.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

PERIOD_SECONDS = 0.05  # forty renewals in the life of a lease
REPORT_SECONDS = 0.25
TRUST_SECONDS = 1.0  # either side takes the other for dead that has been silent for so long
AGAIN_SECONDS = 5.0
PRIORITY = -10  # as nice counts it, where that is permitted: renewing is very little work, and must not wait behind any other


class LeaseKeeper:
    """Starts the process and tells it what to renew; one thread may call.

    ``config`` is the text of the zenoh configuration of a client of the service.
    """

    def __init__(self, config: str) -> None:
        self._config, self._sent = config, b""
        self._process: subprocess.Popen[bytes] | None = None
        self._stale = False
        self._rest = self._line = b""
        self._heard, self._began = float("-inf"), float("-inf")
        self.longest = 0.0  # the longest wait [s] between two renewals that was reported since it was last set to 0

    def renew(self, leases: Sequence[tuple[str, bytes]]) -> bool:
        """Say which leases, as key and message, are to be renewed from now on; returns whether the keeper does so. Waits for nothing."""
        if self._stale or self._process is None or self._process.poll() is not None:
            self._start()
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return False
        said = json.dumps([(key, base64.b64encode(lease).decode()) for key, lease in leases]).encode()
        news, self._sent = (b"" if said == self._sent else said), said
        if len(self._rest) < 1 << 20:
            self._rest += news + b"\n"
        with contextlib.suppress(OSError):
            self._rest = self._rest[os.write(process.stdin.fileno(), self._rest) :]
        with contextlib.suppress(BlockingIOError):
            self._hear(os.read(process.stdout.fileno(), 65536))
        return time.monotonic() - self._heard < TRUST_SECONDS

    def restart(self) -> None:
        """Begin anew with the next call of `renew`, with the keys and certificates that are there then; any thread may call."""
        self._stale, self._began = True, float("-inf")

    def close(self) -> None:
        """End the process."""
        process, self._process, self._heard = self._process, None, float("-inf")
        if process is not None:
            process.kill()
            process.communicate()

    def _start(self) -> None:
        if time.monotonic() - self._began < AGAIN_SECONDS:
            return
        self.close()
        self._stale = False
        command = [sys.executable, "-I", str(Path(__file__)), str(os.getpid())]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                os.set_blocking(pipe.fileno(), False)
        self._began, self._sent, self._line = time.monotonic(), b"", b""
        self._rest = json.dumps(self._config).encode() + b"\n"

    def _hear(self, report: bytes) -> None:
        """Take note of what the keeper reports: it is there, and how long it waited."""
        *lines, self._line = (self._line + report).split(b"\n")
        if lines:
            self._heard = time.monotonic()
            self.longest = max(self.longest, *map(float, lines))


class Renewals:
    """The keeper's own side: what it was sent last, and when."""

    def __init__(self, publisher: Callable[[str], Any]) -> None:
        self._publisher, self._publishers = publisher, dict[str, Any]()
        self._leases: list[tuple[str, bytes]] = []
        self._updated = float("-inf")
        self._rest = b""

    def hear(self, data: bytes) -> None:
        """Take what the service says."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if lines:
            self._updated = time.monotonic()
        for line in filter(None, lines):
            self._leases = [(key, base64.b64decode(lease)) for key, lease in json.loads(line)]

    def renew(self) -> None:
        """Publish every lease, unless the service has been silent."""
        if time.monotonic() - self._updated < TRUST_SECONDS:
            for key, lease in self._leases:
                if key not in self._publishers:
                    self._publishers[key] = self._publisher(key)
                self._publishers[key].put(lease)


def keep_leases() -> None:
    """Renew until the service closes the pipe."""
    import zenoh

    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, signal.SIG_IGN)  # the service decides
    said = b""
    while b"\n" not in said:
        said += os.read(0, 65536) or sys.exit()
    config, _, said = said.partition(b"\n")
    session = zenoh.open(zenoh.Config.from_json5(json.loads(config)))

    def publisher(key: str) -> Any:
        """Not express: such messages fill a queue one by one, and those of many machines that wait for a busy computer are dropped; others share a batch."""
        return session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.REAL_TIME)

    renewals, last, reported, longest = Renewals(publisher), time.monotonic(), 0.0, 0.0
    renewals.hear(said)
    while True:
        if select.select([0], [], [], max(last + PERIOD_SECONDS - time.monotonic(), 0))[0]:
            data = os.read(0, 65536)
            if not data:
                os._exit(0)  # leaving the interpreter in order would wait for the network
            renewals.hear(data)
        now = time.monotonic()
        if now - last >= PERIOD_SECONDS:
            longest, last = max(longest, now - last), now
            renewals.renew()
        if now - reported >= REPORT_SECONDS:
            os.write(1, f"{longest:.6f}\n".encode())
            reported, longest = now, 0.0


if __name__ == "__main__":
    keep_leases()
