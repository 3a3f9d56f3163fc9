"""Service and rig as processes that are killed, stopped and started in any order, in the middle of bursts."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from afdsvc.app.ask import ask_service
from afdsvc.errors import AfdsvcError
from afdsvc.files.recording.mcap_records import is_finished
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.wire.messages import EventKind


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen]:
    started = subprocess.Popen([sys.executable, "-m", "afdsvc", *arguments], stderr=subprocess.DEVNULL)
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def eventually(condition: Callable[[], object], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while True:
        try:
            if condition():
                return
        except AfdsvcError:
            pass
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.1)


def ended(p: subprocess.Popen) -> float:
    began = time.monotonic()
    p.terminate()
    assert p.wait(30) == 0
    return time.monotonic() - began


@pytest.mark.timeout(600)
def test_killed_and_stopped_in_the_middle_of_bursts(tmp_path, free_port):
    path = tmp_path / "site.toml"
    path.write_text(f"""site = "t"
[transport]
listen = ["tcp/127.0.0.1:{free_port}"]
[[machines]]
id = "bearing"
plant = "gas_bearing"
bursts = {{seconds = 4.0, rest_seconds = 0.0}}
""")
    site, folder = read_site(path), tmp_path / "recordings"

    def machine() -> dict:
        return ask_service(site, "status", "kim")["machines"][0]

    def play() -> None:
        eventually(lambda: machine()["state"] == "running" and ask_service(site, "burst", "kim")["burst"])
        time.sleep(1.0)
        assert machine()["burst"]

    with ExitStack() as stack:
        rig = stack.enter_context(process("rig", str(path), "--machine", "bearing"))  # first: it waits for nobody
        time.sleep(1.0)
        first = stack.enter_context(process("serve", str(path)))
        play()
        first.kill()
        first.wait()
        (torn,) = folder.glob("bearing-*.mcap")
        assert not is_finished(torn)
        kept = len(list(Recording(torn).blocks()))

        second = stack.enter_context(process("serve", str(path)))
        eventually(lambda: is_finished(torn))
        assert len(list(Recording(torn).blocks())) == kept
        assert "was not closed" in Recording(torn).metadata["recovered"]["loss"]
        play()
        rig.send_signal(signal.SIGUSR1)
        eventually(lambda: not machine()["burst"], 10)
        try:
            refused = ask_service(site, "burst", "kim")["burst"]
        except AfdsvcError as error:
            refused = str(error)
        assert "emergency stop by signal; bursts are refused until the rig agent is started again" in refused
        assert ended(rig) < 5.0

        rig = stack.enter_context(process("rig", str(path), "--machine", "bearing"))
        play()
        assert ended(second) < 5.0
        assert ended(rig) < 5.0

    (later,) = set(folder.glob("bearing-*.mcap")) - {torn}
    recording = Recording(later)
    assert recording.loss == ""
    causes = [e.cause for e in recording.events() if e.kind is EventKind.BURST_ABORTED]
    for words in ("the service vanished", "emergency stop by signal"):
        assert any(words in cause for cause in causes), causes
    assert all(f.evidence.trustworthy is False for f in recording.findings() if f.evidence.burst)
    assert "raised" not in "".join(e.data.decode(errors="replace") for e in recording.messages(what="log"))
    for session in {b.session for b in recording.blocks()}:
        values = np.vstack([b.role("alpha") for b in recording.blocks() if b.session == session and not b.burst])
        assert not values.any()
