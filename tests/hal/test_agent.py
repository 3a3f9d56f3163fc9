"""The rig agent over real zenoh: it obeys within its limits, and a burst never outlives who asked for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.retuning import DiagnosedFault, Promise, Tuning
from afdsvc.app import ports
from afdsvc.errors import Refused
from afdsvc.files.site import TransportSection as Settings
from afdsvc.hal.agent import RigAgent
from afdsvc.lti.statespace import StateSpace
from afdsvc.service.clock import RealClock
from afdsvc.transport.zenoh_session import Transport
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, EventKind, Lease, RetuneRequest, RigDescription, RigEvent

KEYS = Keys("t")


class Ear:
    """A service that only listens: blocks and events in order."""

    def __init__(self, transport: Transport) -> None:
        self.blocks, self.events, self.transport = [], [], transport
        transport.subscribe(KEYS.blocks(), lambda k, p: self.blocks.append(codec.decode_block(p)))
        transport.subscribe(KEYS.events(), lambda k, p: self.events.append(codec.decode(RigEvent, p)))
        transport.announce(KEYS.service_alive())

    def ask(self, burst: Burst, lease: float = 2.0, machine: str = "bearing"):
        request = BurstRequest(machine, burst, lease, "test", time.time_ns())
        return codec.decode(BurstReply, self.transport.ask(KEYS.burst("bearing"), codec.encode(request)))

    def wait(self, kind: EventKind, seconds: float = 10.0):
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for e in self.events:
                if e.kind is kind:
                    return e
            time.sleep(0.01)
        raise AssertionError(f"no {kind} in {[(e.kind, e.cause) for e in self.events]}")

    def samples(self) -> np.ndarray:
        return np.vstack([b.values for b in self.blocks])


@contextmanager
def rig(settings: Settings, machine, plugins, session: str = "s1") -> Iterator[RigAgent]:
    """Run an agent in a thread."""
    with Transport(settings, hub=False) as transport:
        clock = RealClock()
        config = machine.config.model_copy(update={"driver": machine.config.driver.model_copy(update={"real_time": True})})
        port = ports.open_port(replace(machine, config=config), session, clock, plugins)
        description = RigDescription("bearing", session, 0, port.dt, port.channels, machine.limits)
        agent = RigAgent(KEYS, description, port, transport, clock)
        thread = threading.Thread(target=agent.run, daemon=True)
        thread.start()
        try:
            yield agent
        finally:
            agent.stopping.set()
            thread.join(10)
            assert not thread.is_alive()


@pytest.fixture
def settings(free_port) -> Settings:
    return Settings(listen=[f"tcp/127.0.0.1:{free_port}"])


def sine(seconds: float, amplitude: float = 0.5) -> Burst:
    return Burst("b1", 2, round(seconds * 5000), 250, (Line(0, 390.0, amplitude),))


def test_a_burst_is_played_and_reported(settings, bearing, plugins):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            assert ear.ask(sine(0.5)).accepted
            second = ear.ask(sine(0.5))
            assert not second.accepted
            assert "only one burst" in second.reason
            ear.wait(EventKind.BURST_ENDED)
            time.sleep(0.3)
        ear.wait(EventKind.RIG_STOPPED)
    inside = [b for b in ear.blocks if b.burst == "b1"]
    assert sum(map(len, inside)) == 2500
    assert all(b.k0 + len(b) == c.k0 for b, c in zip(ear.blocks, ear.blocks[1:], strict=False))


def test_wrong_requests_are_refused_with_their_reason(settings, bearing, plugins):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            assert "at most" in ear.ask(sine(20.0)).reason
            assert "would drive output 0" in ear.ask(Burst("b", 2, 5000, 250, (Line(0, 62.0, 5.0),))).reason
            assert "for machine 'other'" in ear.ask(sine(0.5), machine="other").reason
            answer = codec.decode(BurstReply, hub.ask(KEYS.burst("bearing"), b"\xff\xff garbage"))
            assert not answer.accepted
            assert ear.ask(sine(0.2)).accepted
            ear.wait(EventKind.BURST_ENDED)


@pytest.mark.parametrize("how", ["lease", "vanish", "stop"])
def test_a_burst_never_outlives_who_asked_for_it(settings, bearing, plugins, how):
    """Silence, a vanished service, or a stop: alpha fades out and nominal control goes on."""
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            if how == "vanish":
                hub._keep[-1].undeclare()
                time.sleep(0.1)
                assert "would not be supervised" in ear.ask(sine(5.0)).reason
                hub.announce(KEYS.service_alive())
                time.sleep(0.1)
            assert ear.ask(sine(5.0), lease=0.6 if how == "lease" else 5.0).accepted
            assert ear.wait(EventKind.BURST_STARTED).cause == "test"
            time.sleep(0.2)
            if how == "vanish":
                hub._keep[-1].undeclare()
            elif how == "stop":
                hub.ask(KEYS.stop("bearing"), codec.encode(BurstStop("bearing", "enough", "Ada")))
            ended = ear.wait(EventKind.BURST_ABORTED, 3.0)
            time.sleep(0.3)
    words = {"lease": "no renewal from the service", "vanish": "the service vanished", "stop": "stopped by Ada: enough"}
    assert words[how] in ended.cause
    values = ear.samples()
    last = np.flatnonzero(values[:, 4])[-1]
    assert last < len(values) - 500
    assert abs(values[last, 4]) < 0.01
    assert np.isfinite(values).all()


def test_renewed_leases_carry_a_long_burst(settings, bearing, plugins):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            assert ear.ask(sine(1.5), lease=0.5).accepted
            for _ in range(15):
                hub.publish(KEYS.lease("bearing"), codec.encode(Lease("bearing", "b1", 0.5)))
                time.sleep(0.1)
            ear.wait(EventKind.BURST_ENDED)


def test_a_second_rig_with_the_same_id_refuses_to_start(settings, bearing, plugins):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins), Transport(settings, hub=False) as other:
            ear.wait(EventKind.RIG_STARTED)
            machine = bearing()
            clock = RealClock()
            port = ports.open_port(machine, "s2", clock, plugins)
            twin = RigAgent(
                KEYS, RigDescription("bearing", "s2", 0, port.dt, port.channels, machine.limits), port, other, clock
            )
            with pytest.raises(Refused, match=r"has a rig agent already \(session s1\)"):
                twin.run()
            assert port.read() is None


def test_what_is_measured_before_the_network_is_there_is_sent_when_it_is(settings, bearing, plugins, caplog):
    """Control runs for half a second without a session; nothing is lost, nothing is complained of."""
    with Transport(settings, hub=True) as hub:
        ear, machine = Ear(hub), bearing()
        transport, clock = Transport(settings, hub=False), RealClock()
        config = machine.config.model_copy(update={"driver": machine.config.driver.model_copy(update={"real_time": True})})
        port = ports.open_port(replace(machine, config=config), "s1", clock, plugins)
        description = RigDescription("bearing", "s1", 0, port.dt, port.channels, machine.limits)
        agent = RigAgent(KEYS, description, port, transport, clock, connect=lambda stop: (time.sleep(0.5), transport.open()))
        agent.run(1.0)
        ear.wait(EventKind.RIG_STOPPED)
        transport.close()
    assert caplog.records == []
    assert [b.seq for b in ear.blocks] == list(range(20))


SOME_Q = StateSpace(np.diag([0.9, 0.5]), np.ones((2, 2)), 0.002 * np.ones((2, 2)), 0.01 * np.eye(2), 2e-4)
FOUND = DiagnosedFault("horizontal_actuator", -0.5, -0.4)


def retune_request(Q: StateSpace | None = None, lease: float = 1.0, name: str = "q1", promise: Promise | None = None, **changes) -> RetuneRequest:
    made = RetuneRequest("bearing", name, Tuning(Q or SOME_Q, 0.01, 0.01, promise), FOUND, lease, "Ada", time.time_ns(), proof="proved")
    return replace(made, **changes)


def ask_retune(hub: Transport, wanted: RetuneRequest):
    return codec.decode(BurstReply, hub.ask(KEYS.retune("bearing"), codec.encode(wanted)))


@pytest.mark.parametrize("how", ["person", "lease", "vanish", "promise"])
def test_q_acts_until_there_is_a_reason_and_every_block_says_so(settings, bearing, plugins, how):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            broken = Promise(np.eye(2), np.eye(2), 1e-9, 0.3) if how == "promise" else None
            assert ask_retune(hub, retune_request(lease=0.6 if how == "lease" else 5.0, promise=broken)).accepted
            began = ear.wait(EventKind.RETUNED)
            assert (began.burst, began.cause) == ("q1", "accepted by Ada: proved")
            if how == "person":
                other = ask_retune(hub, retune_request(name="q2"))
                assert "another Q acts" in other.reason
                time.sleep(0.2)
                stop = BurstStop("bearing", "enough", "Ada")
                assert codec.decode(BurstReply, hub.ask(KEYS.restore("bearing"), codec.encode(stop))).accepted
            elif how == "vanish":
                time.sleep(0.2)
                hub._keep[-1].undeclare()
            ended = ear.wait(EventKind.RESTORED, 5.0)
            time.sleep(0.3)
            if how == "person":
                stop = codec.encode(BurstStop("bearing", "enough", "Ada"))
                assert "no Q acts on machine" in codec.decode(BurstReply, hub.ask(KEYS.restore("bearing"), stop)).reason
    words = {"person": "restored by Ada: enough", "lease": "no renewal", "vanish": "the service vanished", "promise": "was promised"}
    assert words[how] in ended.cause
    labels = [label for i, label in enumerate(b.tuning for b in ear.blocks) if i == 0 or label != ear.blocks[i - 1].tuning]
    assert labels == ["", "q1 moves", "q1", "q1 moves", ""]
    first = next(b for b in ear.blocks if b.tuning)
    assert first.k0 == began.k
    assert not ear.samples()[:, 4:6].any()  # alpha stays the burst


def test_a_renewed_lease_carries_q(settings, bearing, plugins):
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            assert ask_retune(hub, retune_request(lease=1.0)).accepted
            ear.wait(EventKind.RETUNED)
            for _ in range(20):
                hub.publish(KEYS.lease("bearing"), codec.encode(Lease("bearing", "q1", 1.0)))
                time.sleep(0.1)
            assert not [e for e in ear.events if e.kind is EventKind.RESTORED]
            assert ear.wait(EventKind.RESTORED, 5.0).cause == "the lease expired: no renewal from the service"


def test_what_is_wrong_with_a_q_is_reported_and_nothing_moves(settings, bearing, plugins):
    unstable = StateSpace(1.01 * np.eye(1), np.ones((1, 2)), 0.01 * np.ones((2, 1)), np.zeros((2, 2)), 2e-4)
    with Transport(settings, hub=True) as hub:
        ear = Ear(hub)
        with rig(settings, bearing(), plugins):
            ear.wait(EventKind.RIG_STARTED)
            assert "Q is not stable" in ask_retune(hub, retune_request(unstable)).reason
            assert "Q is 2 x 2 at 0.001 s; expected" in ask_retune(hub, retune_request(StateSpace.gain(np.eye(2), 1e-3))).reason
            assert "for machine 'other'" in ask_retune(hub, retune_request(machine="other")).reason
            assert "at most 10 s" in ask_retune(hub, retune_request(lease=60.0)).reason
            assert "is for session 'x'" in ask_retune(hub, retune_request(session="x")).reason
            assert "s ago by its time stamp" in ask_retune(hub, retune_request(t_ns=time.time_ns() - 10**12)).reason
            assert "are no RetuneRequest message" in codec.decode(BurstReply, hub.ask(KEYS.retune("bearing"), b"\xff\xff")).reason
            time.sleep(0.2)
    assert all(b.tuning == "" for b in ear.blocks)
    assert sum(e.kind is EventKind.RETUNE_REFUSED for e in ear.events) == 7
