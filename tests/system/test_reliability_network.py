"""A rig in a network namespace of its own whose cable is pulled: nothing moves, nothing is invented, what is missing is said."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from afdsvc.app import serve
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, read_site
from afdsvc.service.hub import Hub
from afdsvc.service.scheduler import BurstOrder
from afdsvc.wire.messages import EventKind

NAME = f"afd{os.getpid() % 10_000}"
OURS, THEIRS = "198.18.77.1", "198.18.77.2"  # RFC 2544: for benchmarks, routed nowhere


def ip(*arguments: str) -> bool:
    return subprocess.run(["ip", *arguments], capture_output=True, check=False).returncode == 0


@pytest.fixture
def cable() -> Iterator[str]:
    """A namespace and a cable to it; skipped where this user may not make one."""
    if not shutil.which("ip") or os.geteuid() != 0 or not ip("netns", "add", NAME):
        pytest.skip("no right to make network namespaces here")
    try:
        made = ip("link", "add", NAME, "type", "veth", "peer", "name", "rig0", "netns", NAME)
        made = made and ip("addr", "add", f"{OURS}/30", "dev", NAME) and ip("link", "set", NAME, "up")
        made = made and ip("-n", NAME, "addr", "add", f"{THEIRS}/30", "dev", "rig0") and ip("-n", NAME, "link", "set", "rig0", "up")
        if not made:
            pytest.skip("no veth devices here")
        yield NAME
    finally:
        ip("link", "del", NAME)
        ip("netns", "del", NAME)


@contextmanager
def far_rig(path: Path) -> Iterator[subprocess.Popen]:
    command = ["ip", "netns", "exec", NAME, sys.executable, "-m", "afdsvc", "rig", str(path), "--machine", "bearing"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)
        process.stderr.close()


def site_in(folder: Path, port: int) -> tuple[Path, Site]:
    path = folder / "site.toml"
    path.write_text(f"""site = "t"
[transport]
listen = ["tcp/{OURS}:{port}"]
trusted_network = true
[[machines]]
id = "bearing"
plant = "gas_bearing"
bursts = {{seconds = 1.0, rest_seconds = 0.0}}
""")
    return path, read_site(path)


def eventually(condition: Callable[[], bool], seconds: float = 30.0) -> float:
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < seconds, "it never happened"
        time.sleep(0.05)
    return time.monotonic() - began


def burst(hub: Hub) -> str:
    requests = hub.burst_requests["bearing"]
    name = requests.ask(BurstOrder("test"))
    eventually(lambda: any(e.burst == name for e in list(hub.watches["bearing"].evidence)), 20)
    eventually(lambda: not requests.scheduler.playing, 15)  # its decisions may come sooner than its end
    return name


def pull_the_cable(hub: Hub, cable: str, seconds: float, path: Path) -> None:
    watch, requests = hub.watches["bearing"], hub.burst_requests["bearing"]
    eventually(lambda: watch.present and watch.blocks > 20, 60)
    burst(hub)
    requests.ask(BurstOrder("mid-burst"))
    eventually(lambda: bool(requests.playing))
    time.sleep(0.3)
    session = watch.session
    assert ip("link", "set", cable, "down")
    time.sleep(seconds)
    if seconds > 3:
        assert hub.status().machines[0].state in ("stale", "absent")
    assert ip("link", "set", cable, "up")
    before = watch.blocks
    eventually(lambda: watch.blocks > before + 20 and watch.present, 60)
    eventually(lambda: not requests.playing, 15)
    eventually(lambda: hub.status().machines[0].state == "running")
    assert watch.session == session
    time.sleep(2)
    burst(hub)
    assert hub.alarms.alarms == {}


def check_the_recording(path: Path, lost: int) -> None:
    recording = Recording(path)
    blocks = sorted({b.k0: len(b) for b in recording.blocks()}.items())
    missing = sum(max(b[0] - a[0] - a[1], 0) for a, b in pairwise(blocks))
    assert missing == lost
    said = "\n".join(e.data.decode(errors="replace") for e in recording.messages(what="log"))
    assert bool(missing) == ("are missing before sample" in said)
    ends = [e for e in recording.events() if e.kind in (EventKind.BURST_ABORTED, EventKind.BURST_ENDED)]
    assert ends[0].kind is EventKind.BURST_ENDED
    for finding in recording.findings():
        assert not finding.evidence.detected
    untrusted = {f.evidence.reason for f in recording.findings() if not f.evidence.trustworthy}
    assert any("cut short" in r or "missing" in r or "gap" in r for r in untrusted) or len(ends) >= 3


@pytest.mark.parametrize("seconds", [4.0, pytest.param(60.0, marks=pytest.mark.long)])
def test_a_cable_that_is_pulled_and_put_back(cable, tmp_path, free_port, seconds):
    path, site = site_in(tmp_path, free_port)
    with serve.serving(site) as hub, far_rig(path):
        pull_the_cable(hub, cable, seconds, path)
        lost = hub.watches["bearing"].lost_samples
        hub.drain()
    (recorded,) = (tmp_path / "recordings").glob("bearing-*.mcap")
    check_the_recording(recorded, lost)


def test_a_rig_cut_off_from_everybody_still_stops_in_time(cable, tmp_path, free_port):
    path, site = site_in(tmp_path, free_port)
    with serve.serving(site) as hub, far_rig(path) as rig:
        eventually(lambda: hub.watches["bearing"].blocks > 20, 60)
        assert ip("link", "set", cable, "down")
        time.sleep(1.5)
        began = time.monotonic()
        rig.terminate()
        code = rig.wait(10)
        said = rig.stderr.read().decode(errors="replace")
        assert code == 0, said
        assert "Traceback" not in said
        assert "session is closed" not in said
        assert time.monotonic() - began < 5.0
