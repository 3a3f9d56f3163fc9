"""Requests of long ago and requests that are repeated: refused by rig and service, whatever the clocks say."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.signals import Channel
from afdsvc.hal.agent import RigAgent
from afdsvc.service.clock import FastClock, RealClock, Watchdog
from afdsvc.service.operator_requests import Requests
from afdsvc.transport.freshness import FRESH_SECONDS
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, Command, CommandReply, RigDescription
from afdsvc.wire.requests import ask

NOW = 1_700_000_000_000_000_000
YEAR = 365 * 86400 * 10**9
UNREAD = b"\xfa\x3f\x01x"  # a protobuf field of number 1023, which no reader looks at
BURST = Burst("b1", 1, 100, 10, (Line(0, 50.0, 0.1),))


def rig(k: int = 0) -> RigAgent:
    """Return a rig agent that takes every burst it does not find stale, at sample ``k`` of session ``s``, 1 kHz."""
    description = RigDescription("m1", "s", 1, 1e-3, (Channel("u_x"), Channel("y_x")))
    agent = RigAgent(Keys("t"), description, SimpleNamespace(dt=1e-3), SimpleNamespace(publish=lambda *a: None), FastClock(NOW))
    agent._check = lambda request: None
    agent._k = k
    return agent


def asked(agent: RigAgent, t_ns: int = NOW, start: int = 0, session: str = "", k: int = 0, beside: bytes = b"") -> str:
    """Return why a burst was refused, "" for one that was accepted."""
    payload = codec.encode(BurstRequest("m1", BURST, 2.0, "test", t_ns, start, session, k)) + beside
    reply = codec.decode(BurstReply, agent._on_burst(payload))
    agent._bursts.end()
    return reply.reason


@pytest.mark.parametrize("t_ns", [NOW - 22 * YEAR, NOW - 301 * 10**9, NOW + 301 * 10**9])
def test_a_burst_request_of_another_time_is_refused(t_ns):
    assert "by its time stamp; at most 300 s are accepted" in asked(rig(), t_ns)


def test_a_burst_request_is_obeyed_once():
    agent = rig()
    assert asked(agent) == ""
    assert "has come before" in asked(agent)
    assert "has come before" in asked(agent, beside=UNREAD)
    assert asked(agent, NOW + 1) == ""


def test_a_request_that_names_the_session_is_judged_by_its_samples_not_by_clocks():
    """The clock of the rig is a year off: its machine still gets its bursts."""
    agent = rig(k=400_000)
    assert asked(agent, NOW + YEAR, session="s", k=399_000) == ""
    assert "at most 300 s are accepted" in asked(agent, NOW + YEAR, session="s", k=99_999)
    assert "is for session 'old' of this rig agent" in asked(agent, NOW, session="old", k=399_000)


class Answers:
    """A transport that remembers what the service answers with."""

    def __init__(self) -> None:
        self.served = {}

    def serve(self, key, answer, threads=0):
        self.served[key] = answer

    def answer(self, payload: bytes) -> bytes:
        key = next(key for key in self.served if "/command" in key)
        return self.served[key](payload)


def service(secured: bool) -> tuple[Answers, list[str]]:
    done: list[str] = []
    line = Answers()
    hub = SimpleNamespace(
        transport=line, keys=Keys("t"), clock=RealClock(), status=lambda: "well", audit=None, watchdog=Watchdog(RealClock())
    )  # fmt: skip
    requests = Requests(hub)
    requests.handlers = lambda: {name: lambda a, who, name=name: done.append(name) for name in ("burst", "resume", "stop", "pause", "status")}
    requests.serve(["kim"] if secured else None)
    return line, done


def answered(line: Answers, payload: bytes) -> str:
    return codec.decode(CommandReply, line.answer(payload)).error


@pytest.mark.parametrize("secured", [True, False])
def test_a_command_is_obeyed_once_and_soon(secured):
    line, done = service(secured)
    payloads: list[bytes] = []
    ask(lambda payload: (payloads.append(payload), line.answer(payload))[1], "burst", "kim")
    assert "has come before" in answered(line, payloads[0])
    assert "has come before" in answered(line, payloads[0] + UNREAD)
    old = codec.encode(Command("burst", {}, "kim", time.time_ns() - round(1e9 * FRESH_SECONDS) - 10**10, "n"))
    assert "by its time stamp" in answered(line, old)
    assert done == ["burst"]


def test_a_secured_site_wants_to_know_when_and_others_obey_old_clients():
    bare = codec.encode(Command("burst", {}, "kim"))
    line, done = service(True)
    assert "by its time stamp" in answered(line, bare)
    assert answered(line, codec.encode(Command("status", {}, "kim"))) == ""
    open_line, obeyed = service(False)
    assert answered(open_line, bare) == answered(open_line, bare) == ""
    assert (done, obeyed) == (["status"], ["burst", "burst"])


def test_an_operator_speaks_for_nobody_else():
    """The key a request comes by says who sends it, since zenoh's access rules bind it to a certificate."""
    line, done = service(True)
    assert "says that 'lee' asks; it came from 'kim'" in answered(line, codec.encode(Command("stop", {}, "lee", time.time_ns(), "n")))
    assert done == []


@pytest.mark.parametrize("name", ["stop", "pause"])
def test_what_only_ends_excitation_is_obeyed_however_wrong_a_clock_is(name):
    line, done = service(True)
    assert answered(line, codec.encode(Command(name, {}, "kim", time.time_ns() - YEAR, "n"))) == ""
    assert done == [name]


def test_an_unsecured_service_says_so_at_its_start(tmp_path, free_port):
    (tmp_path / "site.toml").write_text(
        f'site = "t"\n[transport]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n[[machines]]\nid = "m"\nplant = "gas_bearing"\n'
    )
    done = subprocess.run(
        [sys.executable, "-m", "afdsvc", "serve", str(tmp_path / "site.toml"), "--seconds", "0.1", "--log", "json"],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    said = [json.loads(line) for line in done.stderr.splitlines()]
    warnings = [line["message"] for line in said if line["level"] == "warning" and line["logger"] != "afdsvc.service.clock"]
    assert warnings == [
        f"{tmp_path / 'site.toml'}: key 'transport.security' is missing: whoever reaches tcp/127.0.0.1:{free_port} may read all signals "
        "and excite the machines"
    ]
