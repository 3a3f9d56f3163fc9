"""Access rules: zenoh's access control for one site, by the common names of the peers' certificates.

Everything passes the service, which listens, so its rules are the site's. A rig may speak as itself and hear what is meant for it;
an operator may ask the service anything but a Q, for which there are tuners; a viewer may look. Whatever is not allowed is dropped by zenoh before anybody sees it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from afdsvc.files.site import Site
from afdsvc.transport.certificates import common_name, rig_name
from afdsvc.wire.keys import ROOT, Keys

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
        keys.retune(machine), keys.restore(machine), keys.sessions(machine),
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
