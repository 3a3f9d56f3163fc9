"""A secured site obeys nobody it does not know, over real TLS: strangers, wrong certificates, viewers, rigs that pretend."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.app import serve
from afdsvc.app.ask import ask_service
from afdsvc.app.rig import run_rig
from afdsvc.app.serve import audit_file
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Site, TransportSection, parse_site
from afdsvc.service.audit_log import verify_chain
from afdsvc.transport import access_rules
from afdsvc.transport.access_rules import Access
from afdsvc.transport.certificates import check_pair, days_left, ending, key_files, make_certificates, rig_name
from afdsvc.transport.zenoh_session import NoPeer
from afdsvc.transport.zenoh_session import Transport as Session
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstRequest
from afdsvc.wire.requests import ask

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
operators = ["kim", "lee"]
viewers = ["panel"]
tuners = ["lee", "max"]
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
        "ca.pem", "kim.pem", "lee.pem", "max.pem", "panel.pem", "rig.bearing.pem", "rig.other.pem", "service.pem",
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
    return codec.encode(BurstRequest("bearing", burst, 2.0, "pirate", time.time_ns()))


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


def test_an_operator_cannot_speak_for_another_and_the_audit_log_says_who_asked(free_port, certified):
    site = site_of(free_port, certified)
    with running(site), Session(site.transport, False, Access("lee")) as lee:
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask(lambda payload: lee.ask(KEYS.command("kim"), payload, 1.0), "pause", "kim", machine="bearing")
        with pytest.raises(AfdsvcError, match="says that 'kim' asks; it came from 'lee'"):
            ask(lambda payload: lee.ask(KEYS.command("lee"), payload, 1.0), "pause", "kim", machine="bearing")
        ask_service(site, "resume", "lee", machine="bearing")
        burst = ask_service(site, "burst", "kim", machine="bearing")["burst"]
    said = [(e["who"], e["what"], e["outcome"]) for e in verify_chain(audit_file(site)).entries]
    began = max(i for i, (_, what, _) in enumerate(said) if what == "start")
    assert said[began:] == [
        ("service", "start", "done"),
        ("lee", "pause", "the request says that 'kim' asks; it came from 'lee'"),
        ("lee", "resume", "done"),
        ("kim", "burst", "being designed"),
        ("kim", "burst", f"burst {burst} accepted"),
        ("service", "stop", "done"),
    ]


def test_only_tuners_may_retune_and_only_the_service_speaks_to_the_rig(free_port, certified):
    site = site_of(free_port, certified)
    unnamed = "no fault has been named with its severity"
    with running(site) as hub:
        for name in ("lee", "max"):
            with pytest.raises(AfdsvcError, match=unnamed):
                ask_service(site, "retune", name, machine="bearing")
        with pytest.raises(AfdsvcError, match="'kim' may not retune; key"):
            ask_service(site, "retune", "kim", machine="bearing")
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "retune", "panel", machine="bearing")
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "pause", "max", machine="bearing")
        for name in ("kim", "lee", "max"):  # going back is open to all of them
            with pytest.raises(AfdsvcError, match="nothing is restored: no Q acts on machine"):
                ask_service(site, "restore", name, machine="bearing")
        for name in ("panel", "lee", rig_name("other")):
            with Session(site.transport, False, Access(name)) as peer:
                for key in (KEYS.retune("bearing"), KEYS.restore("bearing"), KEYS.retuning("max")):
                    with pytest.raises(AfdsvcError, match=UNHEARD):
                        peer.ask(key, b"", timeout=1.0)
        assert hub.retunings["bearing"].acting == ""
    said = [(e["who"], e["what"]) for e in verify_chain(audit_file(site)).entries]
    assert ("kim", "retune") in said
    assert ("max", "restore") in said


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
    plain = TransportSection(connect=[f"tcp/127.0.0.1:{free_port}"], patience_seconds=2)
    with running(site):
        with pytest.raises(NoPeer), Session(foreign.transport, False, Access("kim")):
            pass
        with pytest.raises(NoPeer), Session(plain, False):
            pass
        with pytest.raises(BadInput, match=r"eve\.pem: does not exist"), Session(site.transport, False, Access("eve")):
            pass


def test_a_certificate_of_the_right_authority_but_of_nobody_listed_may_do_nothing(free_port, certified):
    site = site_of(free_port, certified)
    security = site.transport.security.model_copy(update={"operators": ["kim", "lee", "mallory"]})
    more = site.model_copy(update={"transport": site.transport.model_copy(update={"security": security})})
    make_certificates(more)
    with running(site):
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "status", "mallory")
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(site, "burst", "mallory", machine="bearing")


def test_certificates_are_renewed_and_revoked_without_a_restart(free_port, tmp_path, monkeypatch):
    """A thief has kim's key: it is revoked while the service runs, kim's new one obeyed, and no sample counted twice."""
    site = site_of(free_port, tmp_path)
    make_certificates(site, days=20)
    keys, stolen = tmp_path / "keys", tmp_path / "stolen"
    shutil.copytree(keys, stolen)
    thief = site_of(free_port, tmp_path, "stolen")
    monkeypatch.setattr(access_rules, "LOOK_SECONDS", 0.2)
    with running(site) as hub:
        ask_service(thief, "pause", "kim", machine="bearing")
        renewed = {p.name for p in make_certificates(site, renew=True) if p.suffix == ".pem"}
        assert renewed == {"service.pem", "rig.bearing.pem", "rig.other.pem", "kim.pem", "lee.pem", "max.pem", "panel.pem"}
        until(lambda: said(site, "new keys are taken up"))
        until(lambda: ask_service(site, "status", "kim")["machines"][0]["state"] == "running")
        until(lambda: ask_service(thief, "pause", "kim", machine="bearing"))  # renewed is not revoked; kim's requests are served last
        make_certificates(site, revoke=["kim"])
        until(lambda: said(site, "revoked certificates"))
        until(lambda: ask_service(site, "resume", "kim", machine="bearing"))
        with pytest.raises(AfdsvcError, match=UNHEARD):
            ask_service(thief, "pause", "kim", machine="bearing")
        make_certificates(site, revoke=[rig_name("bearing")])  # the rig reads its new one when it connects again
        until(lambda: said(site, "revoked certificates", 2))
        blocks = hub.watches["bearing"].blocks
        until(lambda: hub.watches["bearing"].blocks > blocks + 40)
        with Session(thief.transport, False, Access(rig_name("bearing"))) as pirate:
            pirate.publish(KEYS.block("bearing"), b"not even a block")
            time.sleep(1.0)
    recording = Recording(next((tmp_path / "recordings").glob("bearing-*.mcap")))
    starts = [block.k0 for block in recording.blocks()]
    assert starts == sorted(set(starts))
    assert unreadable(tmp_path / "recordings", "bearing") == 0
    assert make_certificates(site, renew=True) == []


def said(site: Site, words: str, times: int = 1) -> bool:
    return sum(words in e["what"] for e in verify_chain(audit_file(site)).entries) >= times


def until(condition, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while True:
        with suppress(AfdsvcError):
            if condition():
                return
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.1)


def test_half_of_a_new_pair_is_not_taken_up(tmp_path, certified):
    shutil.copytree(certified / "keys", tmp_path / "keys")
    shutil.copy(tmp_path / "keys" / "kim.key", tmp_path / "keys" / "service.key")
    with pytest.raises(BadInput, match=r"service.pem: cannot be used with service.key"):
        check_pair(key_files(site_of(1, tmp_path).transport.security, "service"))


def test_a_certificate_that_ends_soon_is_reported(tmp_path):
    site = site_of(1, tmp_path)
    make_certificates(site, days=20)
    assert ending(site.transport.security)[0].endswith("kim.pem: ends in 20 days; 'afdsvc certificates SITE.toml --renew' makes a new one")
    assert len(ending(site.transport.security)) == 7
    make_certificates(site, renew=True)
    assert ending(site.transport.security) == []
    assert 364 < days_left(tmp_path / "keys" / "kim.pem") < 366


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
