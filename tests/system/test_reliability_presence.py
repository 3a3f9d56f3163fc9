"""Clocks that step, disks and viewers that stand still: the service goes on watching, and invents nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from afdsvc.app import serve
from afdsvc.app.rig import run_rig
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder
from afdsvc.files.site import Site, parse_site
from afdsvc.service import clock
from afdsvc.service.hub import Hub
from afdsvc.service.scheduler import BurstOrder
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.keys import Keys


def site_of(port: int, folder: Path) -> Site:
    text = f"""site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[recording]
folder = "{folder}"
[[machines]]
id = "bearing"
plant = "gas_bearing"
bursts = {{seconds = 1.0, rest_seconds = 0.0}}
"""
    return parse_site(text, "site.toml")


@contextmanager
def rig(site: Site) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=run_rig, args=(site, "bearing", None, stop), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(15)
        assert not thread.is_alive()


def eventually(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


def judged_burst(hub: Hub) -> None:
    """Play a burst and wait for its decisions: they come soon, they are trusted, and detect nothing."""
    requests = hub.burst_requests["bearing"]
    eventually(lambda: not requests.scheduler.playing, 15)  # of the burst before, decisions may come sooner than its end
    name = requests.ask(BurstOrder("test"))
    found = lambda: [e for e in list(hub.watches["bearing"].evidence) if e.burst == name]  # noqa: E731
    eventually(lambda: bool(found()), 15)
    assert not any(e.detected for e in found())


@pytest.mark.parametrize("step", [-3600.0, 86400.0])
def test_a_wall_clock_that_steps_changes_nothing(free_port, tmp_path, monkeypatch, step):
    off = [0.0]
    stepping = SimpleNamespace(
        time_ns=lambda: time.time_ns() + round(1e9 * off[0]), perf_counter=time.perf_counter, sleep=time.sleep
    )
    monkeypatch.setattr(clock, "time", stepping)
    site = site_of(free_port, tmp_path)
    with serve.serving(site) as hub, rig(site):
        watch = hub.watches["bearing"]
        eventually(lambda: watch.blocks > 15)
        hub.burst_requests["bearing"].ask(BurstOrder("in the middle of a burst"))
        time.sleep(0.4)
        off[0] = step
        eventually(lambda: len({e.burst for e in list(watch.evidence) if e.burst}) == 1, 15)
        judged_burst(hub)
        assert hub.status().machines[0].state == "running"
        assert watch.lost_samples == 0
        assert hub.alarms.alarms == {}
    recording = Recording(next(tmp_path.glob("bearing-*.mcap")))
    assert recording.loss == ""
    (trace,) = recording.traces("bearing")
    assert len(trace) == sum(len(b) for b in recording.blocks())


def test_neither_a_slow_disk_nor_a_viewer_that_hangs_holds_up_detection(free_port, tmp_path, monkeypatch):
    """The disk takes 0.3 s for each block of 50 ms; a viewer stops reading everything it asked for."""
    block = Recorder.block
    monkeypatch.setattr(Recorder, "block", lambda self, *a: (time.sleep(0.3), block(self, *a))[1])
    site, released = site_of(free_port, tmp_path), threading.Event()
    try:
        with serve.serving(site) as hub, Transport(site.transport, False) as viewer, rig(site):
            for pattern in (Keys("t").residuals(), Keys("t").evidences(), Keys("t").blocks()):
                viewer.subscribe(pattern, lambda key, payload: released.wait(60))
            watch = hub.watches["bearing"]
            eventually(lambda: watch.blocks > 15)
            before, began = watch.blocks, time.monotonic()
            judged_burst(hub)
            judged_burst(hub)
            rate = (watch.blocks - before) / (time.monotonic() - began)
            assert rate > 15
            released.set()
            before = time.monotonic()
        assert time.monotonic() - before < 12
    finally:
        released.set()
