"""Which families there are, what each offers, and which laws make sense on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.trial.field import families_moving as moving
from afdsvc.trial.field import families_still as still
from afdsvc.trial.field.kinds_force import LAWS as AT_AXIS
from afdsvc.trial.field.kinds_motion import COMMAND_LAWS as AT_COMMAND
from afdsvc.trial.field.kinds_motion import PROCESS_LAWS as INSIDE
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


@dataclass(frozen=True, slots=True)
class FieldOptions:
    """Settings of one field trial: a family, the names of the hidden laws (none: nothing is hidden), kind of excitation."""

    family: str
    laws: tuple[str, ...] = ()
    repeating: bool = False

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise BadInput(f"option family is '{self.family}'; expected one of {', '.join(FAMILIES)}")
        for law in self.laws:
            if law not in LAWS:
                raise BadInput(f"option laws names '{law}'; expected names from the catalogue")

    def as_json(self) -> dict[str, Any]:
        """Return the options as plain values."""
        return {"family": self.family, "laws": list(self.laws), "repeating": self.repeating}


NOTHING_SHARE, OUTSIDE_SHARE = 0.15, 1 / 3  # of the trials; of those in which something is hidden
COUNTS, CHANCES = (1, 2, 3), (0.6, 0.28, 0.12)  # laws in one machine
SHARES = (0.2, 0.9)  # of the held-out error
STREAM = 20  # separates the numbers drawn here from those of the other parts


def draws(seed: int) -> Iterator[tuple[FieldOptions, float, tuple[str, ...]]]:
    """Yield options, the share asked for, and the first right name of every law (or "outside"), without end."""
    g = np.random.default_rng([seed, STREAM])
    while True:
        for family in g.permutation(list(FAMILIES)):
            laws = () if g.random() < NOTHING_SHARE else _laws(str(family), g)
            options = FieldOptions(str(family), tuple(law.name for law in laws), bool(g.random() < 0.5))
            yield options, float(g.uniform(*SHARES)) if laws else 0.0, tuple(law.label for law in laws)


def _laws(family: str, g: np.random.Generator) -> tuple[Law, ...]:
    """Return one to three laws that make sense on the family and cannot be taken for one another."""
    outside = bool(g.random() < OUTSIDE_SHARE)
    possible = laws_at(family)
    first = [law for law in possible if law.outside == outside] or possible
    chosen = [first[int(g.integers(len(first)))]]
    for _ in range(int(g.choice(COUNTS, p=CHANCES)) - 1):
        others = [law for law in possible if law not in chosen and (outside or not law.outside) and all(apart(law, c) for c in chosen)]
        if others:
            chosen.append(others[int(g.integers(len(others)))])
    return tuple(chosen)
