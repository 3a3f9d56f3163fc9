"""Which families there are, what each offers, and which laws make sense on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.trial.field import families_moving as moving
from afdsvc.trial.field import families_still as still
from afdsvc.trial.field.kinds_command import LAWS as AT_COMMAND
from afdsvc.trial.field.kinds_force import LAWS as AT_AXIS
from afdsvc.trial.field.kinds_process import LAWS as INSIDE
from afdsvc.trial.field.law import Law
from afdsvc.trial.field.rig import Rig

FAMILIES: dict[str, Callable[[np.random.Generator], Rig]] = {
    "motor": moving.motor, "axis": moving.axis, "servo": moving.servo, "arm": moving.arm, "pendulum": moving.pendulum,
    "two_mass": moving.two_mass, "damper": moving.damper, "tanks": still.tanks, "stores": still.stores, "coil": still.coil,
    "levitation": still.levitation, "mirror": still.mirror,
}
_ALL = {"white_box", "steady"}
FEATURES = {  # places where laws act, and what else a law may need
    "motor": _ALL | {"command", "axis", "sensor", "constant", "turning", "open_motor", "inertia"},
    "axis": _ALL | {"command", "axis", "sensor", "constant", "position", "turning", "inertia"},
    "servo": _ALL | {"command", "axis", "sensor", "constant", "position", "spring", "lever", "firmware", "turning", "inertia"},
    "arm": _ALL | {"command", "axis", "sensor", "constant", "position", "spring", "lever", "inertia"},
    "pendulum": {"axis", "sensor", "constant", "white_box", "spring"},
    "two_mass": _ALL | {"command", "axis", "sensor", "constant", "turning", "characteristic", "shaft"},
    "damper": {"axis", "sensor", "constant", "white_box", "position", "spring"},
    "tanks": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "tanks"},
    "stores": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "stores", "still"},
    "coil": _ALL | {"command", "sensor", "constant", "characteristic", "branch", "coil", "still"},
    "levitation": {"axis", "constant", "characteristic", "magnet", "white_box", "command"},
    "mirror": {"command", "sensor", "pair", "steady"},
}
LAWS: dict[str, Law] = {law.name: law for law in (*AT_COMMAND, *AT_AXIS, *INSIDE)}


def laws_at(family: str) -> list[Law]:
    """Return the laws that make sense on a family, in the order of the catalogue."""
    has = FEATURES[family]
    return [law for law in LAWS.values() if {law.place, *law.needs} <= has]


def places(rig: Rig, law: Law) -> int:
    """Return how many places of this sort the machine has; raises `BadInput` when the law makes no sense there."""
    if law not in laws_at(rig.family):
        raise BadInput(f"family '{rig.family}' has no place for law '{law.name}'")
    twice = 2 if law.name in ("root", "spill") else 1
    return {"command": len(rig.inputs), "axis": len(rig.axes), "sensor": len(rig.outputs)}.get(law.place, twice)


def apart(one: Law, other: Law) -> bool:
    """Return whether no name for one law is also a name for the other, so that both can be asked for at once."""
    return not (set(one.accept) & {*other.accept, *other.partial} or set(other.accept) & {*one.accept, *one.partial})
