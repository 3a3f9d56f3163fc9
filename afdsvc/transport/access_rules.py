"""Access rules: zenoh's access control for one site, by the common names of the peers' certificates.

Everything passes the service, which listens, so its rules are the site's. A rig may speak as itself and hear what is meant for it;
an operator may ask the service anything but a Q, for which there are tuners; a viewer may look. Whatever is not allowed is dropped by zenoh before anybody sees it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from afdsvc.api.clock import Clock
from afdsvc.errors import AfdsvcError
from afdsvc.files.site import Site
from afdsvc.transport.certificates import NAMES, check_pair, common_name, ending, key_files, rig_name
from afdsvc.wire.keys import ROOT, SERVICE, Keys

SPEAK = ["put", "declare_queryable", "reply", "liveliness_token"]
LISTEN = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
EVERYTHING = f"{ROOT}/**"
ADVANCED = "@adv/**"  # where zenoh's advanced publishers and subscribers find each other, below every key


@dataclass(frozen=True, slots=True)
class Access:
    """Who this process is (the common name of its certificate) and, for the hub, zenoh's access rules."""

    identity: str = ""
    rules: Mapping[str, Any] = field(default_factory=dict)


NOBODY = Access()


@dataclass(frozen=True, slots=True)
class _Role:
    """What the peers of a role may say and hear, as key expressions."""

    names: Sequence[str]
    says: Sequence[str]
    hears: Sequence[str]
    asks: Sequence[str] = ()


def access_control(
    keys: Keys, machines: Sequence[str], operators: Sequence[str], viewers: Sequence[str], common: Callable[[str], str] = str,
    tuners: Sequence[str] = (),
) -> dict[str, Any]:
    """Return zenoh's ``access_control`` section; nothing is allowed but what is listed.

    ``common`` returns the common name of a bearer's newest certificate.
    """
    open_to_see = [keys.blocks(), keys.events(), keys.descriptions(), keys.residuals(), keys.evidences(), keys.alarms()]
    seen = [*open_to_see, keys.all_alive(), keys.status(), keys.service_alive()]
    roles = {f"rig-{i}": _rig(keys, machine) for i, machine in enumerate(machines)}
    people = dict.fromkeys([*operators, *tuners])
    asked = {name: [keys.command(name)] * (name in operators) + [keys.retuning(name)] * (name in tuners) for name in people}
    roles |= {f"operator-{i}": _Role([name], [], seen, [*asked[name], keys.question()]) for i, name in enumerate(people)}
    leases = [keys.lease(machine) for machine in machines]  # by the keeper of leases; the rest is for the second service, which stands by
    roles["service"] = _Role([SERVICE], leases, [keys.alarms(), keys.service_alive()], [keys.handover()])
    roles["viewers"] = _Role(viewers, [], seen, [keys.question()])
    filled = {id: role for id, role in roles.items() if role.names}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for id, role in filled.items() for rule in _rules(id, role)],
        "subjects": [{"id": id, "cert_common_names": [common(name) for name in role.names]} for id, role in filled.items()],
        "policies": [{"rules": [r["id"] for r in _rules(id, role)], "subjects": [id]} for id, role in filled.items()],
    }


def _rig(keys: Keys, machine: str) -> _Role:
    own = [
        keys.block(machine), keys.event(machine), keys.description(machine), keys.burst(machine), keys.stop(machine),
        keys.retune(machine), keys.restore(machine), keys.inject(machine), keys.sessions(machine),
    ]
    heard = [keys.lease(machine), keys.receipt(machine), keys.service_alive(), keys.sessions(machine)]
    return _Role([rig_name(machine)], own, heard, [keys.stored(machine)])


def _rules(id: str, role: _Role) -> list[dict[str, Any]]:
    """Return what comes in from the role's peers and what goes out to them, seen from the service."""
    says, hears = _with_advanced(role.says), _with_advanced([*role.hears, *role.asks])
    asked = _with_advanced([EVERYTHING]) if says else []  # the service listens with wildcards, which no narrower rule includes
    rules = [
        ("in-says", "ingress", SPEAK, says),
        ("out-asked", "egress", LISTEN, asked),
        ("in-hears", "ingress", LISTEN, hears),
        ("out-heard", "egress", SPEAK, hears),
    ]
    return [
        {"id": f"{id}-{name}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": exprs}
        for name, flow, messages, exprs in rules
        if exprs
    ]


def _with_advanced(exprs: Sequence[str]) -> list[str]:
    return [e for expr in exprs for e in (expr, f"{expr}/{ADVANCED}")]


def access_of(site: Site, identity: str) -> Access:
    """Return who a process of the site is, and the rules by which its service lets others speak."""
    security = site.transport.security
    if security is None:
        return Access(identity)
    machines = [m.id for m in site.machines]
    rules = access_control(Keys(site.site), machines, security.operators, security.viewers, partial(common_name, security), security.tuners)
    return Access(identity, rules)


log = logging.getLogger(__name__)
LOOK_SECONDS = 2.0
WAIT_SECONDS = 60.0  # for a burst to end, before a renewed certificate is taken up all the same
WARN_SECONDS = 86400.0


class KeyWatch:
    """Looks at the folder of keys in a thread of its own.

    ``reopen(access)`` opens the session of ``identity`` anew with what has changed: its own certificate, the authority's, and which common names are
    obeyed. A burst is waited for, but not when something was revoked. ``busy()`` says whether a burst plays, ``tell(sentence)`` what was done.
    """

    def __init__(
        self, site: Site, identity: str, reopen: Callable[[Access], object], clock: Clock, busy: Callable[[], bool], tell: Callable[[str], object]
    ) -> None:  # fmt: skip
        self._identity = identity
        assert site.transport.security is not None  # noqa: S101 - only a secured site has keys
        self._site, self._security, self._reopen, self._clock, self._busy, self._tell = site, site.transport.security, reopen, clock, busy, tell
        self._seen, self._since, self._warned, self._failed = self._look(), float("-inf"), float("-inf"), ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="keys", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._stop.set()
        self._thread.join(2)

    def _work(self) -> None:
        while not self._stop.wait(LOOK_SECONDS):
            try:
                self._warn()
                self._take_up()
                self._failed = ""
            except AfdsvcError as error:
                if self._failed != (why := str(error)):
                    log.error("new keys cannot be taken up: %s", why)
                self._failed = why
            except Exception:
                log.exception("looking at the keys failed")

    def _look(self) -> dict[Path, tuple[int, int]]:
        """Return what can change the session: inode and time of the files."""
        paths = [self._security.keys / name for name in ("ca.pem", f"{self._identity}.pem", f"{self._identity}.key", NAMES)]
        return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in paths if path.exists()}

    def _take_up(self) -> None:
        now, found = self._clock.monotonic(), self._look()
        if found == self._seen:
            self._since = now
            return
        revoked = found.get(self._security.keys / NAMES) != self._seen.get(self._security.keys / NAMES)
        if self._busy() and not revoked and now - self._since < WAIT_SECONDS:
            return
        check_pair(key_files(self._security, self._identity))
        self._reopen(access_of(self._site, self._identity))
        self._seen = found
        self._tell("revoked certificates and new keys are taken up" if revoked else "new keys are taken up")

    def _warn(self) -> None:
        if self._clock.monotonic() - self._warned > WARN_SECONDS:
            self._warned = self._clock.monotonic()
            for sentence in ending(self._security):
                log.warning("%s", sentence)
