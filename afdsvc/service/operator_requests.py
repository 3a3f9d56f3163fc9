"""Requests of operators to the running service and their answers as JSON values: bursts, pauses, alarms."""

from __future__ import annotations

import dataclasses
import math
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

from afdsvc.api.retuning import DiagnosedFault
from afdsvc.errors import AfdsvcError, BadInput, Refused
from afdsvc.service.burst_requests import BurstRequests
from afdsvc.service.hub import Hub
from afdsvc.service.retuning import Retuning
from afdsvc.service.scheduler import BurstOrder
from afdsvc.transport.freshness import Freshness
from afdsvc.wire import codec
from afdsvc.wire.messages import Alarm, Command, CommandReply
from afdsvc.wire.requests import QUESTIONS, RETUNING

Arguments = Mapping[str, Any]
Handler = Callable[[Arguments, str], Any]
SAFE = ("stop", "pause", "restore")  # obeyed however wrong a clock is: they only end or hold back excitation
TICKETS = 100  # of the last bursts and retunings that were asked for
ANSWERED_AT_ONCE = 16  # requests of people: a stop does not wait for the design of a burst
PATIENCE = 0.5  # seconds a person waits for the disk to keep what they did


class Requests:
    """The requests one hub answers; each takes arguments and who asks, and returns something `json_values` turns into JSON."""

    def __init__(self, hub: Hub, invite: Callable[[str], Mapping[str, str]] | None = None) -> None:
        self._hub, self._freshness, self._invite = hub, Freshness(hub.clock), invite
        self._operators: Sequence[str] | None = None
        self._tuners: Sequence[str] = ()
        self._bursts, self._tickets = ThreadPoolExecutor(ANSWERED_AT_ONCE, "burst asked for"), dict[str, Future[Any]]()

    def serve(self, operators: Sequence[str] | None = None, tuners: Sequence[str] = ()) -> None:
        """Answer requests from the network; those that change something are obeyed once and soon, or refused, and audited.

        ``operators`` are those of a secured site: each asks at a key of their own and must say when. Only ``tuners`` may retune there.
        """
        self._operators, self._tuners = operators, tuners
        transport, keys, handlers = self._hub.transport, self._hub.keys, self.handlers()
        retuning = {name: handler for name, handler in handlers.items() if name in RETUNING}
        if operators is not None:
            handlers["retune"] = _not_yours
        for operator in [""] if operators is None else operators:
            transport.serve(keys.command(operator), partial(self._obey, operator, handlers), ANSWERED_AT_ONCE)
        for tuner in tuners:
            transport.serve(keys.retuning(tuner), partial(self._obey, tuner, retuning), ANSWERED_AT_ONCE)
        transport.serve(keys.question(), lambda payload: answer(self.questions(), payload))

    def on_page(self, who: str, name: str, arguments: Arguments) -> CommandReply:
        """Answer a person who is signed in to the console: what they may ask elsewhere, checked and audited alike."""
        handlers = self.handlers() | ({} if self._operators is None or who in self._tuners else {"retune": _not_yours})
        command = Command(name, arguments, who, self._now(), secrets.token_hex(8))
        return codec.decode(CommandReply, self._obey(who, handlers, codec.encode(command)))

    def _obey(self, operator: str, handlers: Mapping[str, Handler], payload: bytes) -> bytes:
        began = self._hub.clock.monotonic()
        try:
            return answer(handlers, payload, partial(self._admit, operator), partial(self._audit, operator))
        finally:
            self._hub.watchdog.note("requests", self._hub.clock.monotonic() - began)

    def _audit(self, operator: str, command: Command, reply: CommandReply) -> None:
        if command.name not in QUESTIONS and self._hub.audit:
            later = isinstance(reply.result, Mapping) and "ticket" in reply.result
            self._hub.audit.add(operator or command.asked_by, command.name, command.arguments, reply.error or ("being designed" if later else "done"))

    def _admit(self, operator: str, command: Command) -> None:
        """Raise `Refused` for a command that is not by the ``operator`` whose key it came by, stale, or not new."""
        if operator not in ("", command.asked_by):
            raise Refused(f"the request says that '{command.asked_by[:64]}' asks; it came from '{operator}'")
        if command.name in QUESTIONS or not (operator or command.t_ns):
            return
        if command.name not in SAFE:
            self._freshness.refuse_old(command.t_ns)
        self._freshness.refuse_repeated(codec.encode(command))

    def handlers(self) -> dict[str, Callable[[Arguments, str], Any]]:
        """Return them by name."""
        return {
            "status": lambda a, who: self._hub.status(),
            "alarms": lambda a, who: list(self._hub.alarms.alarms.values()),
            "history": self._history,
            "ticket": self._ticket,
            "ack": self._acknowledge,
            "confirm": lambda a, who: self._done(self._hub.alarms.confirm(_id(a), who, _comment(a), self._now())),
            "reset": lambda a, who: self._done(self._hub.alarms.reset(_id(a), who, _comment(a), self._now())),
            "shelve": lambda a, who: self._done(self._hub.alarms.shelve(_id(a), who, _minutes(a), _comment(a), self._now())),
            "unshelve": lambda a, who: self._done(self._hub.alarms.unshelve(_id(a), who, self._now())),
            "burst": self._burst,
            "retune": self._retune,
            "restore": self._restore,
            "inject": self._inject,
            "console": lambda a, who: self._invited(who),
            "plan": lambda a, who: self._requests_to(a).plan(BurstOrder("a plan", purpose=str(a.get("purpose") or "diagnose"))),
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
        return self._done(self._hub.alarms.acknowledge(_id(a), who, _comment(a), self._now(), _seen(a)))

    def _done(self, alarm: Alarm) -> Alarm:
        """What a person did is kept before it is confirmed to them, unless the disk takes too long."""
        for outbox in self._hub.outboxes[:1]:
            outbox.flush(PATIENCE)
        return alarm

    def _inject(self, a: Arguments, who: str) -> dict[str, Any]:
        try:
            severity = float(a.get("severity") or 0.0)
        except (TypeError, ValueError):
            severity = 1.0
        if not -1 <= severity <= 0:
            raise BadInput(f"severity {a.get('severity')!r}; expected a number from 0 (healthy) to -1 (total loss)")
        requests, fault = self._requests_to(a), str(a.get("fault") or "")
        requests.inject(fault, severity, who)
        return {"machine": requests.machine, "fault": fault, "severity": severity}

    def _invited(self, who: str) -> Mapping[str, str]:
        if self._invite is None:
            raise Refused("the site has no console; expected key 'web.listen' in the site file")
        return self._invite(who)

    def _burst(self, a: Arguments, who: str) -> dict[str, str]:
        """Ask for a burst, which takes as long as its design; with the argument ``later`` the answer is a ticket at once."""
        order = BurstOrder(f"asked by {who}", purpose=str(a.get("purpose") or "diagnose"))
        requests = self._requests_to(a)
        if not a.get("later"):
            return {"burst": requests.ask(order)}
        return self._promised(self._played, requests, order, who)

    def _promised(self, work: Callable[..., Any], *arguments: Any) -> dict[str, str]:
        """Return a ticket for work that is done in a thread of its own."""
        ticket = secrets.token_hex(8)
        self._tickets[ticket] = self._bursts.submit(work, *arguments)
        for old in list(self._tickets)[:-TICKETS]:
            self._tickets.pop(old, None)
        return {"ticket": ticket}

    def _retune(self, a: Arguments, who: str) -> dict[str, Any]:
        """Design, prove and start Q for the machine's verdict; with the argument ``later`` the answer is a ticket at once."""
        retuning, stated = self._retuning_of(a), _stated_fault(a)
        return self._promised(self._retuned, retuning, who, stated) if a.get("later") else self._retuned(retuning, who, stated)

    def _retuned(self, retuning: Retuning, who: str, stated: DiagnosedFault | None) -> dict[str, Any]:
        outcome = "the service failed"
        try:
            sheet = retuning.ask(self._hub.standing(retuning.machine), who, stated)
            outcome = f"Q {sheet['tuning']} accepted"
            return sheet
        except AfdsvcError as error:
            outcome = str(error)
            raise
        finally:
            if self._hub.audit:
                said = {} if stated is None else {"fault": stated.fault, "low": stated.low, "high": stated.high}
                self._hub.audit.add(who, "retune", {"machine": retuning.machine, **said}, outcome)

    def _restore(self, a: Arguments, who: str) -> dict[str, str]:
        retuning = self._retuning_of(a)
        retuning.restore(str(a.get("reason", "")), who)
        return {"machine": retuning.machine}

    def _retuning_of(self, a: Arguments) -> Retuning:
        return self._hub.retunings[self._requests_to(a).machine]

    def _played(self, requests: BurstRequests, order: BurstOrder, who: str) -> dict[str, str]:
        outcome = "the service failed"
        try:
            name = requests.ask(order)
            outcome = f"burst {name} accepted"
            return {"burst": name}
        except AfdsvcError as error:
            outcome = str(error)
            raise
        finally:
            if self._hub.audit:
                self._hub.audit.add(who, "burst", {"machine": requests.machine, "purpose": order.purpose}, outcome)

    def _ticket(self, a: Arguments, who: str) -> dict[str, Any]:
        """Return the result of what a ticket was given for, or the ticket while there is none; raises its refusal."""
        ticket = str(a.get("ticket") or "")
        if ticket not in self._tickets:
            raise BadInput(f"ticket '{ticket[:40]}' is unknown; the service keeps the last {TICKETS} until it stops")
        result = self._tickets[ticket]
        return result.result() if result.done() else {"ticket": ticket}

    def _requests_to(self, a: Arguments) -> BurstRequests:
        watches, burst_requests = self._hub.watches, self._hub.burst_requests
        machine = a.get("machine") or (next(iter(watches)) if len(watches) == 1 else "")
        if not machine:
            raise BadInput(f"no machine is named; expected --machine, one of {', '.join(watches)}")
        if machine not in watches:
            raise BadInput(f"machine {machine!r} is unknown; this site has {', '.join(watches)}")
        if machine not in burst_requests:
            raise AfdsvcError(f"machine '{machine}' can be watched, not excited")
        return burst_requests[str(machine)]

    def _pause(self, a: Arguments, why: str) -> dict[str, str]:
        requests = self._requests_to(a)
        requests.scheduler.paused = why
        return {"machine": requests.machine, "paused": why}


def _stated_fault(a: Arguments) -> DiagnosedFault | None:
    """Return the fault that a person states in place of the verdict, ``NAME=LOW..HIGH`` or ``NAME=SEVERITY``; None when nothing is stated."""
    text = str(a.get("fault") or "")
    if not text:
        return None
    name, _, interval = text.partition("=")
    low, _, high = interval.partition("..")
    try:
        return DiagnosedFault(name.strip(), float(low), float(high or low))
    except ValueError:
        raise BadInput(f"fault '{text[:64]}': expected NAME=LOW..HIGH, for example horizontal_actuator=-0.55..-0.45") from None


def _not_yours(a: Arguments, who: str) -> None:
    raise Refused(f"'{who[:64]}' may not retune; key 'transport.security.tuners' of the site file names who may")


def _id(a: Arguments) -> str:
    return str(a.get("alarm") or "")


def _comment(a: Arguments) -> str:
    return str(a.get("comment") or "")


def _seen(a: Arguments) -> int | None:
    try:
        return None if a.get("seen_ns") is None else int(a["seen_ns"])
    except (TypeError, ValueError):
        raise BadInput(f"seen_ns {a.get('seen_ns')!r}; expected `since_ns` of an occurrence") from None


def _minutes(a: Arguments) -> float:
    try:
        return float(a.get("minutes") or 0)
    except (TypeError, ValueError):
        raise BadInput(f"minutes {a.get('minutes')!r}; expected a number") from None


def answer(
    handlers: Mapping[str, Handler], payload: bytes, check: Callable[[Command], None] = lambda command: None,
    tell: Callable[[Command, CommandReply], None] = lambda command, reply: None,
) -> bytes:  # fmt: skip
    """Return the encoded reply; every failure, that of ``check`` too, becomes one sentence. ``tell`` learns what was replied."""
    command = None
    try:
        command = codec.decode(Command, payload)
        check(command)
        handler = handlers.get(command.name)
        if handler is None:
            raise BadInput(f"unknown command '{command.name}'; known are {', '.join(sorted(handlers))}")
        reply = CommandReply(True, json_values(handler(command.arguments, command.asked_by)))
    except AfdsvcError as error:
        reply = CommandReply(False, error=str(error))
    except Exception as error:
        reply = CommandReply(False, error=f"{type(error).__name__}: {error}")
    if command:
        tell(command, reply)
    return codec.encode(reply)


def json_values(value: Any) -> Any:
    """Return dataclasses, mappings and sequences as JSON values; a number that is not finite becomes None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_values(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(v) for v in value]
    return value
