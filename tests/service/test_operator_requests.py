"""Requests of people: answered at once, whatever the service is busy with."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest

from afdsvc.errors import AfdsvcError, Refused
from afdsvc.service.clock import LONGEST, WINDOW_SECONDS, RealClock, Watchdog
from afdsvc.service.operator_requests import TICKETS, Requests, answer
from afdsvc.wire.requests import ask


class Machine:
    """A machine whose bursts take as long to design as ``free`` is not set."""

    machine = "m"

    def __init__(self, refusal: str = "") -> None:
        self.free, self.refusal, self.scheduler = threading.Event(), refusal, SimpleNamespace(paused="")

    def ask(self, order):
        self.free.wait(10)
        if self.refusal:
            raise Refused(self.refusal)
        return "b1"


def line(machine: Machine):
    """Return what sends a request to a service with this machine."""
    hub = SimpleNamespace(clock=RealClock(), watches={"m": None}, burst_requests={"m": machine}, audit=None, outboxes=[])
    requests = Requests(hub)
    return lambda payload: answer(requests.handlers(), payload)


def until_done(send, ticket: str):
    while "ticket" in (found := ask(send, "ticket", "kim", ticket=ticket)):
        time.sleep(0.01)
    return found


def test_whoever_asks_for_a_burst_gets_a_ticket_at_once_and_its_result_later():
    machine = Machine()
    send = line(machine)
    tickets = [ask(send, "burst", "kim", later=True)["ticket"] for _ in range(40)]  # more than are answered at a time
    assert ask(send, "ticket", "kim", ticket=tickets[0]) == {"ticket": tickets[0]}
    assert ask(send, "pause", "kim", reason="cleaning")["machine"] == "m"
    machine.free.set()
    assert [until_done(send, ticket) for ticket in tickets] == [{"burst": "b1"}] * 40


def test_the_refusal_of_a_burst_comes_by_its_ticket():
    machine = Machine("the rig is in its quiet hours")
    machine.free.set()
    send = line(machine)
    ticket = ask(send, "burst", "kim", later=True)["ticket"]
    with pytest.raises(AfdsvcError, match="quiet hours"):
        until_done(send, ticket)


def test_tickets_are_bounded_and_an_unknown_one_is_refused():
    machine = Machine()
    machine.free.set()
    send = line(machine)
    first, *_ = [ask(send, "burst", "kim", later=True)["ticket"] for _ in range(TICKETS + 1)]
    with pytest.raises(AfdsvcError, match=f"ticket '{first}' is unknown"):
        ask(send, "ticket", "kim", ticket=first)


class Hours:
    """A clock that is set."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


def test_the_watchdog_keeps_the_longest_waits_of_the_last_windows_and_reports_dangerous_ones(caplog):
    clock = Hours()
    watchdog = Watchdog(clock)
    for wait in (0.1, LONGEST["leases"] + 0.5, 0.2, LONGEST["leases"] + 0.1):
        watchdog.note("leases", wait)
    assert watchdog.longest()["leases"] == LONGEST["leases"] + 0.5
    assert [r.getMessage() for r in caplog.records] == ["leases waited 1.5 s; expected at most 1 s: is the computer overloaded?"]
    clock.now = WINDOW_SECONDS + 1
    watchdog.note("leases", 0.3)
    assert watchdog.longest() == dict.fromkeys(LONGEST, 0.0) | {"leases": LONGEST["leases"] + 0.5}
    clock.now *= 2
    assert watchdog.longest()["leases"] == 0.3
