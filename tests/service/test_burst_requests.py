"""The burst desk: when a burst may start, and what it says when it may not."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.errors import Refused
from afdsvc.files.site import Bursts
from afdsvc.service.burst_requests import LEASE_SECONDS, BurstRequests
from afdsvc.service.clock import FastClock, RealClock
from afdsvc.service.hub import Hub
from afdsvc.service.scheduler import BurstOrder, Scheduler
from afdsvc.service.sinks import FanOut
from afdsvc.transport.zenoh_session import PeerSilent
from afdsvc.wire import codec
from afdsvc.wire.keys import Keys
from afdsvc.wire.messages import BurstReply, BurstRequest, BurstStop, ServiceStatus

DT = 1e-3


def desk(ready_at: int | None, seconds: float = 10.0) -> tuple[BurstRequests, list]:
    requests: list = []

    def ask(_key: str, payload: bytes, timeout: float = 5.0) -> bytes:
        requests.append(codec.decode(BurstRequest, payload))
        return codec.encode(BurstReply(True, requests[-1].burst.name))

    transport = SimpleNamespace(ask=ask, publish=lambda *a, **k: None)
    stream = SimpleNamespace(ready_at=ready_at, dt=DT, announce=lambda burst: None, bursts={})
    sink = FanOut([])
    burst = Burst("b", 1, 1000, 100, (Line(0, 50.0, 1.0),))
    scheduler = Scheduler(Bursts(every_seconds=5.0, first_after_seconds=1.0), np.random.default_rng(0), 0.0)
    made = BurstRequests("m1", lambda wanted: burst, scheduler, stream, sink, Keys("t"), transport, RealClock())
    made.present("s1", seconds)
    return made, requests


def test_a_burst_somebody_asks_for_at_once_waits_until_it_can_be_judged():
    made, requests = desk(ready_at=400, seconds=0.1)
    made.ask(BurstOrder("asked"))
    assert requests[0].start == 400


def test_a_machine_that_has_long_been_judged_is_excited_at_once():
    made, requests = desk(ready_at=400, seconds=10.0)
    made.ask(BurstOrder("asked"))
    assert requests[0].start == 0


def test_a_machine_that_sends_nothing_usable_is_not_excited():
    made, requests = desk(ready_at=None)
    with pytest.raises(Refused, match="no usable samples yet"):
        made.ask(BurstOrder("asked"))
    made.tick()
    assert requests == []
    assert made._asking is None


def test_a_machine_that_was_interrupted_long_before_its_window_is_full_is_refused_with_the_time_to_wait():
    made, requests = desk(ready_at=30_000, seconds=10.0)
    with pytest.raises(Refused, match="ask again in 20 s"):
        made.ask(BurstOrder("asked"))
    made.tick()
    assert made._asking is None
    assert requests == []


def test_the_wait_counts_before_a_burst_is_given_up():
    made, _ = desk(ready_at=4000, seconds=0.1)
    made.ask(BurstOrder("asked"))
    left = made._deadline - made.clock.monotonic()
    assert left == pytest.approx(3.9 + 1.0 + 0.4 + 5.0, abs=0.5)


def test_a_request_that_is_not_answered_is_taken_back():
    """The rig may accept it late; it would begin a burst whose lease nobody renews."""
    made, _ = desk(ready_at=400)
    stops: list[str] = []

    def ask(key: str, payload: bytes, timeout: float = 5.0) -> bytes:
        if key.endswith("/stop"):
            stops.append(codec.decode(BurstStop, payload).burst)
            return codec.encode(BurstReply(True, stops[-1]))
        raise PeerSilent(f"no answer within {timeout:g} s")

    made.transport.ask = ask
    with pytest.raises(PeerSilent, match="within 20 s"):
        made.ask(BurstOrder("asked"))
    assert made.playing == ""
    assert stops == [f"s1-{made._run}-1"]


def test_what_a_rig_said_is_waited_for_until_its_samples_are_past_the_burst():
    made, requests = desk(ready_at=400)
    made.clock, said = FastClock(), []
    made.sink = SimpleNamespace(take=lambda message: said.append(message.value))
    made.ask(BurstOrder("asked"))
    made.clock.sleep_until(100.0)  # the service stood still; what came meanwhile is not worked off
    made.tick()
    assert made.playing == requests[0].burst.name
    assert made.lease() is None
    made.present("s1", 15.0)
    made.tick()
    assert made.playing
    made.present("s1", 17.0)
    made.tick()
    assert not made.playing
    assert "never ended" in said[-1].sentence


def test_a_burst_on_a_machine_that_is_gone_is_given_up():
    made, _ = desk(ready_at=400)
    made.clock, said = FastClock(), []
    made.sink = SimpleNamespace(take=lambda message: said.append(message.value))
    made.ask(BurstOrder("asked"))
    made.present("", 10.0)
    made.tick()
    assert made.playing
    made.clock.sleep_until(100.0)
    made.tick()
    assert not made.playing
    assert "is given up: the rig agent is not connected" in said[-1].sentence


def test_a_second_request_does_not_wait_for_the_design_of_the_first():
    made, _ = desk(ready_at=400)
    designing, free = threading.Event(), threading.Event()
    design = made.design
    made.design = lambda order: (designing.set(), free.wait(10), design(order))[2]
    first = threading.Thread(target=made.play, args=(BurstOrder("first"),))
    first.start()
    assert designing.wait(5)
    with pytest.raises(Refused, match="a burst is being prepared"):
        made.play(BurstOrder("second"))
    free.set()
    first.join()
    assert made.playing


@pytest.mark.parametrize("busy", ["status", "tick", "judging"])
def test_leases_are_renewed_whatever_the_service_is_busy_with(busy):
    """Telling the status to a viewer that stalls, planning a burst, judging a block: each takes five seconds here."""
    made, _ = desk(ready_at=400)
    leases: list[float] = []
    free = threading.Event()

    def publish(key: str, payload: bytes, keep: bool = True) -> None:
        if key.endswith("/lease"):
            leases.append(time.monotonic())
        elif busy == "status":
            free.wait(5)

    made.transport.publish = publish
    made.transport.subscribe = made.transport.watch = made.transport.announce = lambda *a, **k: None
    watch = SimpleNamespace(machine="m1", take_description=lambda payload: free.wait(5))
    hub = Hub(Keys("t"), "0", {"m1": watch}, {"m1": made}, made.transport, RealClock(), lambda: ("", 0, "", 0))
    hub.status = lambda: ServiceStatus("t", "0", 1, 1.0)
    made.ask(BurstOrder("asked"))
    made.tick = lambda: free.wait(5) if busy == "tick" else None
    hub._next_status = 0.0
    hub.start()
    if busy == "judging":
        hub._put("description", "afdsvc/t/m1/description", b"")
    time.sleep(2.5)
    free.set()
    hub.stop()
    assert len(leases) >= 8
    assert np.diff(leases).max() < LEASE_SECONDS / 2
    assert 0 < hub.watchdog.longest()["leases"] < LEASE_SECONDS / 2
