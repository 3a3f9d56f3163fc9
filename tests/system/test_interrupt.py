"""Ctrl-C: the command ends by itself or is ended, and nothing half-written stays."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

STUCK = """
    import sys, time, os
    from pathlib import Path
    from afdsvc.cli.interrupt import end_on_interrupt
    from afdsvc.files.unfinished import writing

    end_on_interrupt()
    folder = Path(sys.argv[1])
    with writing(folder, folder / "half.txt"):
        folder.mkdir()
        (folder / "half.txt").write_text("half")
        ready = False
        while True:
            try:
                if not ready:
                    ready = bool(os.write(1, b"ready\\n"))
                time.sleep(0.05)
            except KeyboardInterrupt:
                if sys.argv[2] == "hears":
                    raise
"""


@pytest.mark.parametrize("command", ["hears", "hears nothing"])
def test_what_is_being_written_is_removed(tmp_path: Path, command: str):
    """The second swallows the interruption, as compiled code and libraries with threads do."""
    script = tmp_path / "stuck.py"
    script.write_text(textwrap.dedent(STUCK))
    process = subprocess.Popen([sys.executable, str(script), str(tmp_path / "out"), command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGINT)
    assert ("afdsvc: interrupted" in errors) == (command == "hears nothing")
    assert not (tmp_path / "out").exists()


def test_a_failure_removes_what_is_new_and_keeps_what_was_there(tmp_path: Path):
    from afdsvc.files.unfinished import writing

    (tmp_path / "old").write_text("old")
    with pytest.raises(RuntimeError), writing(tmp_path / "old", tmp_path / "new"):  # noqa: PT012
        (tmp_path / "new").write_text("half")
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


def test_an_error_that_an_interruption_became_is_one():
    from afdsvc.cli.interrupt import was_interrupted

    with pytest.raises(SystemError) as became:  # noqa: PT012 - as compiled code does it
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise SystemError("a result with an exception set") from stop
    assert was_interrupted(became.value)
    assert not was_interrupted(SystemError())


HELD = """
    import os, signal, threading
    from afdsvc.cli.interrupt import call_on_signals

    lock, called = threading.Lock(), threading.Event()
    call_on_signals({signal.SIGTERM: lambda: lock.acquire() and called.set()})
    with lock:
        os.kill(os.getpid(), signal.SIGTERM)
        [None for _ in range(100_000)]  # handlers run here
    called.wait()
    print("called")
"""


def test_what_a_signal_calls_may_need_a_lock_that_the_main_thread_holds():
    """As `threading.Event.set` does while the main thread waits for the event: a rig that was interrupted twice hung for ever."""
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(HELD)], capture_output=True, text=True, timeout=120)
    assert done.stdout == "called\n", done.stderr
