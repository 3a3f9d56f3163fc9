"""Every zenoh key of afdsvc, and its purpose. Key expressions are written nowhere else.

A key is ``afdsvc/{site}/{machine}/{what}`` for what belongs to one machine, so that one access rule on
``afdsvc/{site}/{machine}/**`` grants or refuses it as a whole, and ``afdsvc/{site}/service/{what}`` for the service.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from afdsvc.errors import BadInput

ROOT = "afdsvc"
SERVICE = "service"
# Beside the characters zenoh keeps for itself, those that make file names, recording topics or viewer paths ambiguous.
_FORBIDDEN = re.compile(r"[/*$#?@\\\"'<>|:\s\x00-\x1f\x7f-\x9f\ud800-\udfff]")
_LONGEST = 64


def checked_id(what: str, value: str) -> str:
    """Return a site or machine id that can be a chunk of a key; raises `BadInput` naming the character that cannot."""
    if not value:
        raise BadInput(f"{what} id is empty; expected a short name like 'bearing-1'")
    if len(value) > _LONGEST:
        raise BadInput(f"{what} id '{value[:_LONGEST]}...' has {len(value)} characters; expected at most {_LONGEST}")
    found = _FORBIDDEN.search(value)
    if found:
        expected = "expected letters, digits and the signs - _ ."
        raise BadInput(f"{what} id {value!r} contains {found.group()!r}; {expected}")
    if value[0] in ".-":
        raise BadInput(f"{what} id {value!r} begins with '{value[0]}'; expected a letter, a digit or _ first")
    return value


def checked_machine(value: str) -> str:
    """Return a machine id; raises `BadInput` as `checked_id`, and for the word the service itself is found under."""
    if value == SERVICE:
        raise BadInput(f"machine id '{SERVICE}' is taken by the service itself; expected another name")
    return checked_id("machine", value)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one site; raises `BadInput` when the site id cannot be part of a key."""

    site: str

    def __post_init__(self) -> None:
        checked_id("site", self.site)

    def block(self, machine: str) -> str:
        """Samples, published by the rig: the stream everything else is derived from."""
        return self._of(machine, "block")

    def event(self, machine: str) -> str:
        """What happened on the rig, published by it: a burst started, ended, was cut short or refused."""
        return self._of(machine, "event")

    def description(self, machine: str) -> str:
        """Channels, limits and controller, published by the rig at its start and answered on query for late joiners."""
        return self._of(machine, "description")

    def burst(self, machine: str) -> str:
        """Query to the rig to play a burst; the reply says accepted or refused and why, so nothing is assumed."""
        return self._of(machine, "burst")

    def stop(self, machine: str) -> str:
        """Query to the rig to end the burst now, over its ramp."""
        return self._of(machine, "stop")

    def retune(self, machine: str) -> str:
        """Query to the rig to let a Q act beside its controller; the reply says accepted or refused and why."""
        return self._of(machine, "retune")

    def restore(self, machine: str) -> str:
        """Query to the rig to go back to Q = 0."""
        return self._of(machine, "restore")

    def inject(self, machine: str) -> str:
        """Query to the rig of a simulated machine to put a fault into it; a real machine refuses."""
        return self._of(machine, "inject")

    def lease(self, machine: str) -> str:
        """Renewals from whoever asked for a burst or a Q; without them the rig ends it, so no machine is excited after the service has died."""
        return self._of(machine, "lease")

    def receipt(self, machine: str) -> str:
        """What the service has recorded, published by it every second: the rig keeps everything else on its disk."""
        return self._of(machine, "receipt")

    def stored(self, machine: str) -> str:
        """Query to the service with a block of samples that the rig kept during an outage."""
        return self._of(machine, "stored")

    def alive(self, machine: str, session: str) -> str:
        """Liveliness token of one start of a rig; it names the session so that a second rig of the same id is seen."""
        return f"{self._of(machine, 'alive')}/{checked_id('session', session)}"

    def sessions(self, machine: str) -> str:
        """Every liveliness token of one machine: a rig asks before it starts whether its id is taken."""
        return f"{self._of(machine, 'alive')}/*"

    def residual(self, machine: str) -> str:
        """Whitened residual, published by the service for viewers, so they need no model."""
        return self._of(machine, "residual")

    def evidence(self, machine: str) -> str:
        """Decisions of the detectors, published by the service for viewers and whoever reacts to them."""
        return self._of(machine, "evidence")

    def alarm(self, machine: str) -> str:
        """What happens to the machine's alarms, published by the service for displays and notifications."""
        return self._of(machine, "alarm")

    def service_alive(self) -> str:
        """Liveliness token of the service: its loss ends bursts on the rigs, its presence stops a second service."""
        return f"{ROOT}/{self.site}/{SERVICE}/alive"

    def status(self) -> str:
        """State of the service and its machines, published every second for displays."""
        return f"{ROOT}/{self.site}/{SERVICE}/status"

    def command(self, operator: str = "") -> str:
        """Query to the service from people: status, burst, retune, alarms, ack, confirm, shelve, pause, resume.

        On a secured site every operator has one of their own, so that the key says who asks.
        """
        key = f"{ROOT}/{self.site}/{SERVICE}/command"
        return f"{key}/{checked_id('operator', operator)}" if operator else key

    def retuning(self, operator: str) -> str:
        """Query to the service of a secured site from those who may retune: a key of its own for each, so that others can be kept from it."""
        return f"{ROOT}/{self.site}/{SERVICE}/retuning/{checked_id('operator', operator)}"

    def question(self) -> str:
        """Query to the service that changes nothing: status, alarms, history, ticket; apart, so that viewers can be let at it."""
        return f"{ROOT}/{self.site}/{SERVICE}/question"

    def blocks(self) -> str:
        """The blocks of every machine of the site, for the service."""
        return self._every("block")

    def events(self) -> str:
        """The events of every machine of the site, for the service."""
        return self._every("event")

    def descriptions(self) -> str:
        """The descriptions of every machine of the site, for the service and viewers."""
        return self._every("description")

    def all_alive(self) -> str:
        """The liveliness tokens of every rig of the site, for the service."""
        return f"{self._every('alive')}/*"

    def handover(self) -> str:
        """Query of a service that stands by to the one that serves: the alarms, as JSON of encoded changes."""
        return f"{ROOT}/{self.site}/{SERVICE}/handover"

    def residuals(self) -> str:
        """The residuals of every machine of the site, for viewers."""
        return self._every("residual")

    def evidences(self) -> str:
        """The decisions about every machine of the site, for viewers."""
        return self._every("evidence")

    def alarms(self) -> str:
        """The alarms of every machine of the site, for displays."""
        return self._every("alarm")

    def _of(self, machine: str, what: str) -> str:
        return f"{ROOT}/{self.site}/{checked_machine(machine)}/{what}"

    def _every(self, what: str) -> str:
        return f"{ROOT}/{self.site}/*/{what}"


@lru_cache(maxsize=4096)  # asked for every message
def machine_of(key: str) -> str:
    """Return the machine a received key belongs to; raises `BadInput` when it is not a key of a machine."""
    parts = key.split("/")
    if len(parts) < 4 or parts[0] != ROOT:
        raise BadInput(f"key '{key}' is not afdsvc/<site>/<machine>/<what>")
    return checked_machine(parts[2])


def session_of(key: str) -> str:
    """Return the session named by a liveliness token; raises `BadInput` for any other key."""
    parts = key.split("/")
    if len(parts) != 5 or parts[0] != ROOT or parts[3] != "alive":
        raise BadInput(f"key '{key}' is not afdsvc/<site>/<machine>/alive/<session>")
    return parts[4]
