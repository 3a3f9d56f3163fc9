"""Requests of operators to the running service and their answers as JSON values: bursts, pauses, alarms."""

from __future__ import annotations

import dataclasses
import math
import secrets
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.service.hub import Hub
from afdsvc.service.scheduler import BurstOrder
from afdsvc.transport.freshness import Freshness
from afdsvc.wire import codec
from afdsvc.wire.messages import Alarm, Command, CommandReply

Arguments = Mapping[str, Any]
SAFE = ("stop", "pause")  # obeyed however wrong a clock is: they only end or hold back excitation
QUESTIONS = ("status", "alarms", "history")  # requests that change nothing
ANSWERED_AT_ONCE = 16  # requests of people: a stop does not wait for the design of a burst
PATIENCE = 2.0  # seconds a person waits for the disk to keep what they did


class Requests:
    """The requests one hub answers; each takes arguments and who asks, and returns something `plain` turns into JSON."""

    def __init__(self, hub: Hub) -> None:
        self._hub, self._freshness = hub, Freshness(hub.clock)

    def serve(self, secured: bool = False) -> None:
        """Answer requests from the network; those that change something are obeyed once and soon, or refused.

        On a ``secured`` site they must say when they were made.
        """
        transport, keys = self._hub.transport, self._hub.keys
        check = partial(self._refuse_stale, secured)
        transport.serve(keys.command(), lambda payload: answer(self.handlers(), payload, check), ANSWERED_AT_ONCE)
        transport.serve(keys.question(), lambda payload: answer(self.questions(), payload))

    def _refuse_stale(self, secured: bool, command: Command, payload: bytes) -> None:
        if command.name in QUESTIONS or not (secured or command.t_ns):
            return
        if command.name not in SAFE:
            self._freshness.refuse_old(command.t_ns)
        self._freshness.refuse_repeated(payload)

    def handlers(self) -> dict[str, Callable[[Arguments, str], Any]]:
        """Return them by name."""
        return {
            "status": lambda a, who: self._hub.status(),
            "alarms": lambda a, who: list(self._hub.alarms.alarms.values()),
            "history": self._history,
            "ack": self._acknowledge,
            "confirm": lambda a, who: self._done(self._hub.alarms.confirm(_id(a), who, _comment(a), self._now())),
            "reset": lambda a, who: self._done(self._hub.alarms.reset(_id(a), who, _comment(a), self._now())),
            "shelve": lambda a, who: self._done(self._hub.alarms.shelve(_id(a), who, _minutes(a), _comment(a), self._now())),
            "unshelve": lambda a, who: self._done(self._hub.alarms.unshelve(_id(a), who, self._now())),
            "burst": self._burst,
            "stop": lambda a, who: self._requests_to(a).stop(str(a.get("reason", "")), who),
            "pause": lambda a, who: self._pause(a, f"by {who}: {a.get('reason', '')}"),
            "resume": lambda a, who: self._pause(a, ""),
        }

    def questions(self) -> dict[str, Callable[[Arguments, str], Any]]:
        """Return those that change nothing."""
        return {name: handler for name, handler in self.handlers().items() if name in QUESTIONS}

    def _now(self) -> int:
        return self._hub.clock.now_ns()

    def _history(self, a: Arguments, who: str) -> list[Any]:
        return self._hub.history.changes(str(a.get("alarm") or "")) if self._hub.history else []

    def _acknowledge(self, a: Arguments, who: str) -> Alarm:
        return self._done(self._hub.alarms.acknowledge(_id(a), who, _comment(a), self._now(), a.get("seen_ns")))

    def _done(self, alarm: Alarm) -> Alarm:
        """What a person did is kept before it is confirmed to them, unless the disk takes too long."""
        for outbox in self._hub.outboxes[:1]:
            outbox.flush(PATIENCE)
        return alarm

    def _burst(self, a: Arguments, who: str) -> dict[str, str]:
        wanted = BurstOrder(f"asked by {who}", purpose=str(a.get("purpose") or "diagnose"))
        return {"burst": self._requests_to(a).ask(wanted)}

    def _requests_to(self, a: Arguments) -> BurstRequests:
        watches, burst_requests = self._hub.watches, self._hub.burst_requests
        machine = a.get("machine") or (next(iter(watches)) if len(watches) == 1 else "")
        if machine not in watches:
            raise BadInput(f"machine {machine!r} is unknown; this site has {', '.join(watches)}")
        if machine not in burst_requests:
            raise AfdsvcError(f"machine '{machine}' can be watched, not excited")
        return burst_requests[str(machine)]

    def _pause(self, a: Arguments, why: str) -> dict[str, str]:
        requests = self._requests_to(a)
        requests.scheduler.paused = why
        return {"machine": requests.machine, "paused": why}


def _id(a: Arguments) -> str:
    return str(a.get("alarm") or "")


def _comment(a: Arguments) -> str:
    return str(a.get("comment") or "")


def _minutes(a: Arguments) -> float:
    try:
        return float(a.get("minutes") or 0)
    except (TypeError, ValueError):
        raise BadInput(f"minutes {a.get('minutes')!r}; expected a number") from None


Handler = Callable[[Mapping[str, Any], str], Any]


def answer(
    handlers: Mapping[str, Handler], payload: bytes, check: Callable[[Command, bytes], None] = lambda command, payload: None
) -> bytes:
    """Return the encoded reply; every failure, that of ``check`` too, becomes one sentence."""
    try:
        command = codec.decode_command(payload)
        check(command, payload)
        handler = handlers.get(command.name)
        if handler is None:
            raise BadInput(f"unknown command '{command.name}'; known are {', '.join(sorted(handlers))}")
        reply = CommandReply(True, plain(handler(command.arguments, command.asked_by)))
    except AfdsvcError as error:
        reply = CommandReply(False, error=str(error))
    except Exception as error:
        reply = CommandReply(False, error=f"{type(error).__name__}: {error}")
    return codec.encode_command_reply(reply)


def ask(send: Callable[[bytes], bytes], name: str, asked_by: str, **arguments: Any) -> Any:
    """Send a command with ``send`` and return its result; raises `AfdsvcError` with the service's sentence."""
    command = Command(name, arguments, asked_by, time.time_ns(), secrets.token_hex(8))
    reply = codec.decode_command_reply(send(codec.encode_command(command)))
    if not reply.ok:
        raise AfdsvcError(reply.error)
    return reply.result


def plain(value: Any) -> Any:
    """Return dataclasses, mappings and sequences as JSON values; a number that is not finite becomes None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value
