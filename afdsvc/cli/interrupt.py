"""Ctrl-C ends a command within a second, whatever it computes, and leaves no half-written file."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from typing import NoReturn

from afdsvc.files.unfinished import remove_unfinished

GRACE = 0.4  # seconds for the command to end by itself
INTERRUPTED = 130  # exit code, as shells give it


def end_on_interrupt() -> None:
    """Raise `KeyboardInterrupt` on SIGINT, and end the process where that is not heard within `GRACE`.

    Compiled code hears nothing before it returns. The byte that Python writes for every signal wakes a thread that needs no answer of it.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    read, write = socket.socketpair()
    write.setblocking(False)
    signal.set_wakeup_fd(write.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=_wait, args=(read, write), name="interrupt", daemon=True).start()


def end_in_order() -> None:
    """Leave the end to the command: it stops its machines and closes its recordings when it is interrupted."""
    signal.set_wakeup_fd(-1)


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


def _wait(read: socket.socket, write: socket.socket) -> None:
    while signal.SIGINT not in read.recv(1):
        pass
    time.sleep(GRACE)
    leave()
