"""Supervision by systemd (notify protocol: ready, alive, stopping) and JSON logs."""

from __future__ import annotations

import ctypes
import gc
import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from afdsvc import is_compiled

FIELDS = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, logger, thread, message, and what the caller added with ``extra``."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line = {
            "time": self.formatTime(record, "%Y-%m-%dT%H:%M:%S") + f".{int(record.msecs):03d}",
            "level": record.levelname.lower(), "logger": record.name, "thread": record.threadName, "message": record.getMessage(),
        }  # fmt: skip
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        line |= {key: value for key, value in vars(record).items() if key not in FIELDS}
        return json.dumps(line, default=str)


def start_logging(form: str) -> None:
    """Send what the service logs to stderr, as ``text`` or as ``json`` lines; the journal of systemd has times of its own."""
    handler = logging.StreamHandler(sys.stderr)
    when = "" if "JOURNAL_STREAM" in os.environ else "%(asctime)s "
    handler.setFormatter(JsonLines() if form == "json" else logging.Formatter(f"{when}afdsvc: %(levelname)s: %(message)s", "%Y-%m-%d %H:%M:%S"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    if not is_compiled():
        logging.getLogger("afdsvc").info("compiling, once on this computer: up to a minute")


def notify(state: str) -> None:
    """Tell systemd (``NOTIFY_SOCKET``) about this process; does nothing without a supervisor."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as s:
        try:
            s.connect("\0" + address[1:] if address.startswith("@") else address)
            s.sendall(state.encode())
        except OSError as error:
            logging.getLogger(__name__).warning("cannot notify the supervisor of '%s': %s", state, error)


@contextmanager
def supervised(healthy: Callable[[], bool]) -> Iterator[None]:
    """Say ready on entry and stopping on exit; in between feed the watchdog as long as ``healthy()``.

    A service whose worker hangs is not fed, and systemd restarts it.
    """
    over = threading.Event()
    period = float(os.environ.get("WATCHDOG_USEC", 0)) / 1e6 / 3

    def feed() -> None:
        while not over.wait(period):
            if healthy():
                notify("WATCHDOG=1")

    notify("READY=1")
    thread = threading.Thread(target=feed, name="watchdog", daemon=True)
    if period:
        thread.start()
    try:
        yield
    finally:
        over.set()
        notify("STOPPING=1")
        if period:
            thread.join(5)


def collect_rarely() -> None:
    """Let Python look for cycles rarely, and never among what is there already.

    A black box keeps a minute of blocks of every machine: tens of thousands of objects that are in no cycle, which the collector
    would otherwise go through again and again.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def return_memory(every: float = 60.0) -> None:
    """Give memory that is free back to the system once in ``every`` seconds, in a thread of its own, where the C library is glibc's.

    By itself it keeps what the queues of an outage took in the heap of each thread, so that every outage adds to the size of the process. Cycles are looked
    for first: the root finder of SciPy leaves one that holds the arrays of a burst's threshold.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None

    def work() -> None:
        while trim:
            time.sleep(every)
            gc.collect()
            trim(0)

    threading.Thread(target=work, name="memory", daemon=True).start()
