"""A service that is away for longer than a rig's memory lasts: no sample is lost, and what was kept is delivered by itself."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.signals import Block, Channel
from afdsvc.app import serve
from afdsvc.app.rig import run_rig
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, parse_site
from afdsvc.hal import store
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire.codec import encode_block
from afdsvc.wire.keys import Keys


def site_of(port: int, folder: Path) -> Site:
    text = f"""site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
cache_blocks = 10
store = "store"
[recording]
folder = "recordings"
[[machines]]
id = "bearing"
plant = "gas_bearing"
"""
    return parse_site(text, "site.toml", folder)


def until(condition, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.1)


def test_every_sample_of_an_outage_is_recorded_afterwards(free_port, tmp_path, monkeypatch):
    """The rig begins 4 s before the service, which is away again for 6 s; its memory holds 0.5 s."""
    for name, seconds in (("SPILL_SECONDS", 2.0), ("DELIVER_SECONDS", 1.0), ("AGAIN_SECONDS", 5.0)):
        monkeypatch.setattr(store, name, seconds)
    site, stop = site_of(free_port, tmp_path), threading.Event()
    rig = threading.Thread(target=run_rig, args=(site, "bearing", None, stop), daemon=True)
    kept = tmp_path / "store"
    rig.start()
    try:
        time.sleep(4.0)
        with pytest.raises(Refused, match="machine 'bearing' has a rig agent already"):  # no service is needed to know that
            run_rig(site, "bearing", 1.0, threading.Event())
        with serve.serving(site) as hub:
            until(lambda: hub.watches["bearing"].seconds_seen > 6)
        time.sleep(6.0)
        assert list(kept.glob("*.blocks"))
        with serve.serving(site) as hub:
            until(lambda: hub.watches["bearing"].blocks and not list(kept.glob("*.blocks")))
            end = round(5000 * hub.watches["bearing"].seconds_seen)
    finally:
        stop.set()
        rig.join(10)
    held = np.zeros(end, dtype=int)
    for path in (tmp_path / "recordings").glob("bearing-*.mcap"):
        for trace in Recording(path).traces():
            k0 = int(trace.notes["k0"])
            held[k0 : k0 + len(trace.values)] += 1
    assert held.all(), f"{np.sum(held == 0)} samples are missing"


def test_a_rig_delivers_blocks_of_its_own_machine_only(free_port, tmp_path):
    channels = (Channel("u_x"), Channel("y_x"))
    other = encode_block(Block("other", "s1", 0, 0, 1e-3, 0, channels, np.zeros((5, 2))))
    site = site_of(free_port, tmp_path)
    with serve.serving(site), Transport(site.transport, False) as rig:
        for payload, words in ((b"rubbish", "are no Block message"), (other, "a block of machine 'other' delivered by the rig agent of 'bearing'")):
            with pytest.raises(AfdsvcError, match=words):
                rig.ask(Keys("t").stored("bearing"), payload)
    assert not list((tmp_path / "recordings").glob("*.mcap"))
