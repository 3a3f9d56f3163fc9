"""zenoh as it really behaves here: two sessions on loopback."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest

from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.site import TransportSection as Settings
from afdsvc.transport.zenoh_session import PeerSilent, Transport
from afdsvc.wire.codec import decode
from afdsvc.wire.messages import Lease
from benchmarks.support.proxy import Proxy


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture
def settings() -> Settings:
    return Settings(listen=[f"tcp/127.0.0.1:{free_port()}"])


def wait_for(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()


def test_everything_published_arrives_in_order(settings):
    got: list[int] = []
    with Transport(settings, hub=True) as hub, Transport(settings, hub=False) as rig:
        hub.subscribe("afdsvc/t/*/block", lambda key, payload: got.append(int(payload)))
        for i in range(500):
            rig.publish("afdsvc/t/m/block", str(i).encode())
        assert wait_for(lambda: len(got) >= 500)
    assert got == list(range(500))


def test_a_subscriber_that_stalls_for_8_s_loses_nothing(settings):
    """It sleeps in its callback while blocks keep coming at four times the rate of a 5 kHz machine.

    With a lease of 2 s instead of zenoh's 10 s the link is cut in the stall and blocks are lost.
    """
    stall, blocks = 8, 800
    got: list[int] = []

    def hear(key: str, payload: bytes) -> None:
        if len(got) == 20:
            time.sleep(stall)
        got.append(int.from_bytes(payload[:8], "little"))

    with Transport(settings, hub=True) as hub, Transport(settings, hub=False) as rig:
        hub.subscribe("afdsvc/t/*/block", hear)
        for i in range(blocks):
            rig.publish("afdsvc/t/m/block", i.to_bytes(8, "little") + bytes(20_000))
            time.sleep(0.0125)
        assert wait_for(lambda: len(got) >= blocks, 20), (len(got), blocks, hub.lost)
    assert got == list(range(blocks))


def test_a_thousand_messages_that_nobody_can_read_are_one_line_of_the_log(settings, caplog):
    got: list[bytes] = []

    def hear(key: str, payload: bytes) -> None:
        got.append(payload)
        if payload != b"good":
            decode(Lease, payload)

    with Transport(settings, hub=True) as rig, Transport(settings, hub=False) as stranger:
        rig.subscribe("afdsvc/t/m/lease", hear, missed=False)
        for payload in (*[b"\xff rubbish"] * 1000, b"good"):
            stranger.publish("afdsvc/t/m/lease", payload)
        assert wait_for(lambda: b"good" in got)
    assert len(got) > 500
    (line,) = (record for record in caplog.records if "lease" in record.message)
    assert line.exc_info is None
    assert "are no Lease message" in line.message


def test_queries_get_an_answer_or_the_reason(settings):
    with Transport(settings, hub=True) as hub, Transport(settings, hub=False) as rig:

        def answer(payload: bytes) -> bytes:
            if payload == b"boom":
                raise ValueError("no such burst")
            return payload.upper()

        rig.serve("afdsvc/t/m/burst", answer)
        time.sleep(0.2)
        assert hub.ask("afdsvc/t/m/burst", b"hello") == b"HELLO"
        with pytest.raises(AfdsvcError, match="no such burst"):
            hub.ask("afdsvc/t/m/burst", b"boom")
        with pytest.raises(PeerSilent, match="no answer at afdsvc/t/other/burst"):
            hub.ask("afdsvc/t/other/burst", b"")


def test_a_peer_that_hangs_is_a_timeout_not_an_answer(settings):
    release = threading.Event()
    with Transport(settings, hub=True) as hub, Transport(settings, hub=False) as rig:
        rig.serve("afdsvc/t/m/burst", lambda p: (release.wait(3) and p) or p)
        time.sleep(0.2)
        with pytest.raises(PeerSilent, match=r"within 0\.5 s"):
            hub.ask("afdsvc/t/m/burst", b"", timeout=0.5)
        release.set()


def test_presence_is_seen_and_so_is_its_end(settings):
    seen: list[tuple[str, bool]] = []
    with Transport(settings, hub=True) as hub:
        hub.watch("afdsvc/t/*/alive/*", lambda key, alive: seen.append((key, alive)))
        with Transport(settings, hub=False) as rig:
            rig.announce("afdsvc/t/m/alive/s1")
            assert wait_for(lambda: ("afdsvc/t/m/alive/s1", True) in seen)
            assert hub.alive("afdsvc/t/m/alive/*") == ["afdsvc/t/m/alive/s1"]
        assert wait_for(lambda: ("afdsvc/t/m/alive/s1", False) in seen)


def test_two_hubs_at_one_place_and_a_client_without_a_hub_are_named(settings):
    with (
        Transport(settings, hub=True),
        pytest.raises(BadInput, match="cannot listen at"),
        Transport(settings, hub=True),
    ):
        pass
    lonely = Settings(listen=[f"tcp/127.0.0.1:{free_port()}"], patience_seconds=0.5)
    with pytest.raises(BadInput, match="no service answers at"), Transport(lonely, hub=False):
        pass


def test_it_is_known_whether_anybody_listens(settings):
    key = "afdsvc/t/m/residual"
    with Transport(settings, hub=True) as hub:
        assert not hub.heard(key)
        with Transport(settings, hub=False) as viewer:
            viewer.subscribe(key, lambda key, payload: None, missed=False)
            assert wait_for(lambda: hub.heard(key))
        assert wait_for(lambda: not hub.heard(key))
    assert not hub.heard("afdsvc/t/other/residual"), "closed: nobody, and no error"


def test_an_outage_loses_nothing_the_publisher_still_keeps(settings):
    """600 messages are published while the cable is out: more than the 200 that were once fetched afterwards."""
    network = Proxy(int(settings.listen[0].rsplit(":", 1)[1]))
    heard: list[int] = []
    try:
        with Transport(settings, True) as hub:
            hub.subscribe("a/b", lambda key, payload: heard.append(int(payload)))
            with Transport(Settings(connect=[f"tcp/127.0.0.1:{network.port}"]), False) as rig:
                for i in range(100):
                    rig.publish("a/b", str(i).encode())
                assert wait_for(lambda: len(heard) == 100)
                network.cut()
                time.sleep(0.5)
                for i in range(100, 700):
                    rig.publish("a/b", str(i).encode())
                network.mend()
                wait_for(lambda: len(heard) >= 700, 15)
        assert heard == list(range(700))
    finally:
        network.close()


def test_a_slow_answer_holds_up_no_other_where_threads_answer(settings):
    """A stop is answered while the design of a burst takes long."""
    free = threading.Event()

    def answer(payload: bytes) -> bytes:
        if payload == b"design":
            free.wait(20)
        return payload

    with Transport(settings, True) as hub, Transport(settings, False) as person, Transport(settings, False) as other:
        hub.serve("a/command", answer, 4)
        slow = threading.Thread(target=person.ask, args=("a/command", b"design", 30.0))
        slow.start()
        time.sleep(0.3)
        assert other.ask("a/command", b"stop", 3.0) == b"stop"
        free.set()
        slow.join()


def test_strangers_who_connect_and_say_nothing_keep_nobody_out(settings):
    """400 connections that never begin to speak: with zenoh's own bound, 100, rigs were shut out for 10 s at a time."""
    host, port = settings.listen[0].removeprefix("tcp/").split(":")
    with Transport(settings, hub=True), ExitStack() as strangers:
        for _ in range(400):
            strangers.enter_context(socket.create_connection((host, int(port)), timeout=5))
        with Transport(settings, hub=False) as rig:
            assert rig.alive("afdsvc/**") == []
