"""A secured site obeys nobody it does not know, over real TLS: strangers, wrong certificates, viewers, rigs that pretend."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.app import serve
from afdsvc.app.ask import ask_service
from afdsvc.app.rig import run_rig
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, Transport, parse_site
from afdsvc.transport.access_rules import Access, rig_name
from afdsvc.transport.certificates import make_certificates
from afdsvc.transport.zenoh_session import NoPeer
from afdsvc.transport.zenoh_session import Transport as Session
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstRequest

KEYS = Keys("t")
UNHEARD = "lacks permission for this request"


def site_of(port: int, folder: Path, keys: str = "keys") -> Site:
    text = f"""
site = "t"
[transport]
listen = ["tls/127.0.0.1:{port}"]
patience_seconds = 2
[transport.security]
keys = "{keys}"
operators = ["kim"]
viewers = ["panel"]
[recording]
folder = "recordings"
[[machines]]
id = "bearing"
plant = "gas_bearing"
[[machines]]
id = "other"
plant = "gas_bearing"
"""
    return parse_site(text, "site.toml", folder)


@pytest.fixture(scope="module")
def certified(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("secured")
    made = make_certificates(site_of(1, folder))
    assert sorted(p.name for p in made if p.suffix == ".pem") == [
        "ca.pem", "kim.pem", "panel.pem", "rig.bearing.pem", "rig.other.pem", "service.pem",
    ]
    assert {oct(p.stat().st_mode & 0o777) for p in made if p.suffix == ".key"} == {"0o600"}
    return folder


@contextmanager
def running(site: Site) -> Iterator[serve.Hub]:
    stop = threading.Event()
    rig = threading.Thread(target=run_rig, args=(site, "bearing", None, stop), daemon=True)
    with serve.serving(site) as hub:
        rig.start()
        try:
            deadline = time.monotonic() + 30
            while hub.watches["bearing"].blocks < 3:
                assert time.monotonic() < deadline, "the rig never came"
                time.sleep(0.05)
            yield hub
        finally:
            stop.set()
            rig.join(15)


def request() -> bytes:
    burst = Burst("pirate", 2, 5000, 250, (Line(0, 600.0, 1.0),))
    return codec.encode_burst_request(BurstRequest("bearing", burst, 2.0, "pirate", time.time_ns()))


def test_only_those_who_may_are_obeyed(free_port, certified, tmp_path):
    site = site_of(free_port, certified)
    with running(site) as hub:
        assert ask_service(site, "status", "panel")["machines"][0]["state"] == "running"
        assert ask_service(site, "status", "kim")["machines"][0]["state"] == "running"
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "burst", "panel", machine="bearing")
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "stop", "panel", machine="bearing")
        for name in ("panel", "kim", rig_name("other")):
            with Session(site.transport, False, Access(name)) as peer, pytest.raises(AfdsvcError, match=UNHEARD):
                peer.ask(KEYS.burst("bearing"), request(), timeout=1.0)
        assert hub.refusals == []
        assert hub.burst_requests["bearing"].playing == ""
        assert ask_service(site, "burst", "kim", machine="bearing")["burst"]


def unreadable(folder: Path, machine: str) -> int:
    """Return how often the service said that a message of the machine could not be read."""
    found = [e.data for path in folder.glob(f"{machine}-*.mcap") for e in Recording(path).messages(what="log")]
    return sum(b"could not be read" in data for data in found)


def test_a_viewer_sees_but_cannot_speak_and_a_rig_only_as_itself(free_port, certified):
    site = site_of(free_port, certified)
    with running(site) as hub:
        seen: list[str] = []
        with Session(site.transport, False, Access("panel")) as panel, Session(site.transport, False, Access("rig.other")) as other:
            panel.subscribe(KEYS.blocks(), lambda key, payload: seen.append(key))
            for peer, machine in ((panel, "bearing"), (panel, "other"), (other, "bearing"), (other, "other")):
                peer.publish(KEYS.block(machine), b"not even a block")
            time.sleep(1.5)
        hub.drain()
        assert hub.watches["bearing"].lost_samples == 0
    assert set(seen) == {KEYS.block("bearing"), KEYS.block("other")}
    assert unreadable(certified / "recordings", "bearing") == 0
    assert unreadable(certified / "recordings", "other") == 1


def test_strangers_and_foreign_certificates_do_not_get_in(free_port, certified, tmp_path):
    site = site_of(free_port, certified)
    foreign = site_of(free_port, tmp_path)
    make_certificates(foreign)
    plain = Transport(connect=[f"tcp/127.0.0.1:{free_port}"], patience_seconds=2)
    with running(site):
        with pytest.raises(NoPeer), Session(foreign.transport, False, Access("kim")):
            pass
        with pytest.raises(NoPeer), Session(plain, False):
            pass
        with pytest.raises(BadInput, match=r"eve\.pem: does not exist"), Session(site.transport, False, Access("eve")):
            pass


def test_a_certificate_of_the_right_authority_but_of_nobody_listed_may_do_nothing(free_port, certified):
    site = site_of(free_port, certified)
    security = site.transport.security.model_copy(update={"operators": ["kim", "mallory"]})
    more = site.model_copy(update={"transport": site.transport.model_copy(update={"security": security})})
    make_certificates(more)
    with running(site):
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "status", "mallory")
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "burst", "mallory", machine="bearing")


def test_what_is_there_is_kept_and_the_authority_key_is_needed_for_more(certified):
    site = site_of(1, certified)
    assert make_certificates(site) == []
    os.rename(certified / "keys" / "ca.key", certified / "ca.key.away")
    try:
        with pytest.raises(BadInput, match=r"ca\.key: is not there"):
            make_certificates(site)
    finally:
        os.rename(certified / "ca.key.away", certified / "keys" / "ca.key")


@pytest.mark.parametrize(
    ("transport", "sentence"),
    [
        ('listen = ["tcp/0.0.0.0:7447"]', "reachable from other computers; set 'security'"),
        ('connect = ["tcp/192.168.1.5:7447"]', "reachable from other computers"),
        ('listen = ["tcp/127.0.0.1:7447"]\nsecurity = {keys = "k"}', "every endpoint is 'tls/host:port'"),
        ('listen = ["tls/h:1"]\nsecurity = {keys = "k", operators = ["kim"], viewers = ["kim"]}', "'kim' is operator and viewer"),
    ],
)
def test_an_open_door_is_refused_at_the_start(transport, sentence):
    with pytest.raises(BadInput, match=sentence):
        parse_site(f'site = "t"\n[transport]\n{transport}\n[[machines]]\nid = "m"\nplant = "gas_bearing"', "site.toml")
