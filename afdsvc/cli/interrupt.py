"""Ctrl-C ends a command within a second, whatever it computes, and leaves no half-written file."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import NoReturn

from afdsvc.files.unfinished import remove_unfinished

GRACE = 0.4  # seconds for the command to end by itself
INTERRUPTED = 130  # exit code, as shells give it


def end_on_interrupt() -> None:
    """Raise `KeyboardInterrupt` on SIGINT, and end the process where that is not heard within `GRACE`.

    Compiled code hears nothing before it returns.
    """
    if threading.current_thread() is threading.main_thread():
        call_on_signals({signal.SIGINT: _leave_soon})
        signal.signal(signal.SIGINT, signal.default_int_handler)


def call_on_signals(called: Mapping[int, Callable[[], object]]) -> None:
    """Call a function when a signal arrives, from a thread of its own; those of an earlier call hear nothing any more.

    A handler runs between two steps of the main thread, which may hold the very lock that the handler needs to set an event. The byte
    that Python writes for every signal wakes a thread that needs no answer of the main thread.
    """
    read, write = socket.socketpair()
    write.setblocking(False)
    signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)
    for number in called:
        signal.signal(number, lambda *_: None)
    threading.Thread(target=_listen, args=(read, write, called), name="signals", daemon=True).start()


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an interruption is behind an error: compiled code turns it into one of its own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def leave() -> NoReturn:
    """Say so and end, without waiting for threads and libraries to be taken down."""
    remove_unfinished()
    os.write(2, b"\nafdsvc: interrupted\n")
    os._exit(INTERRUPTED)


def _listen(read: socket.socket, write: socket.socket, called: Mapping[int, Callable[[], object]]) -> None:
    while True:
        called.get(read.recv(1)[0], lambda: None)()


def _leave_soon() -> None:
    time.sleep(GRACE)
    leave()
