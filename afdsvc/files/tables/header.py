"""What the names of a table's columns say: quantity, unit and role, as in ``speed_rpm``, ``Torque [Nm]`` or ``u_force``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from afdsvc.api.signals import ROLES
from afdsvc.errors import BadInput
from afdsvc.files.tables.mapping import same_unit

INPUTS = ("voltage", "force", "torque", "current", "command", "duty", "pwm", "drive", "valve", "input", "effort")
OUTPUTS = ("position", "speed", "velocity", "angle", "acceleration", "displacement", "pressure", "level", "rate", "output", "rpm", "deflection")
TIMES = ("t", "time", "timestamp", "datetime", "date", "zeit", "stamp")
SPELT = {"Nm": "N*m", "C": "degC", "degs": "deg/s", "rads": "rad/s", "mps": "m/s", "mms": "mm/s"}


@dataclass(frozen=True, slots=True)
class Heading:
    """A column: its ``name`` in the file, the ``label`` and ``unit`` it says, and its role ("u", "y", "aux", or "t" for the time)."""

    name: str
    label: str
    unit: str
    role: str


def heading(name: str, inputs: Sequence[str] = (), outputs: Sequence[str] = ()) -> Heading:
    """Return what a name says; ``inputs`` and ``outputs`` hold names whose role is known.

    >>> heading("speed_rpm")
    Heading(name='speed_rpm', label='speed', unit='rpm', role='y')
    >>> heading("Motor Torque [Nm]").role, heading("t_ms").unit, heading("aux_temperature").role
    ('u', 'ms', 'aux')
    """
    prefix, _, rest = name.partition("_")
    own = prefix if prefix in ROLES and rest else ""
    words, unit = _unit_of(rest if own else name)
    label = re.sub(r"\W+", "_", words.strip()).strip("_").lower() or "signal"
    if name in inputs or name in outputs:
        return Heading(name, label, unit, "u" if name in inputs else "y")
    role = own or _role(label)
    return Heading(name, rest if own and not unit else label, unit, role)


def _unit_of(name: str) -> tuple[str, str]:
    """Return a name without its unit, and the unit: in brackets, or what follows the last underscore if it is one."""
    found = re.fullmatch(r"(.*?)\s*[\[(]([^\])]+)[\])]\s*", name) or re.fullmatch(r"(.+)_([A-Za-z%/0-9]+)", name)
    unit = SPELT.get(found.group(2), found.group(2)) if found else ""
    return (found.group(1), unit) if found and _is_unit(unit) else (name, "")


def _is_unit(text: str) -> bool:
    try:
        return same_unit(text, text + "*1", text) or True
    except BadInput:
        return False


def _role(label: str) -> str:
    words = label.split("_")
    for role, known in (("t", TIMES), ("u", INPUTS), ("y", OUTPUTS)):
        if any(word in known for word in words):
            return role
    return "aux"
