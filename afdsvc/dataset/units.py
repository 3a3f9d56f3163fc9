"""Units as dimensions: what a variable is by its unit."""

from __future__ import annotations

from difflib import get_close_matches
from functools import lru_cache
from typing import Any

_VELOCITIES = ("[length]/[time]", "1/[time]")
COMMON = ("volt", "rpm", "rad/s", "deg/s", "m/s", "mm/s", "m/s^2", "mm", "um", "rad", "deg", "N*m", "degC", "bar", "kPa", "L/min")  # one may be meant by a unit that is none


@lru_cache(maxsize=1)
def unit_registry() -> Any:
    """Return pint's registry of units, one for the process."""
    from pint import UnitRegistry  # a third of a second, for those who convert

    return UnitRegistry()


def with_unit(number: str, unit: str) -> str:
    """Return a number as text with its unit; without one where it is dimensionless.

    >>> with_unit("0.3", "rad/s"), with_unit("105", "1")
    ('0.3 rad/s', '105')
    """
    return number if unit in ("", "1") else f"{number} {unit}"


@lru_cache(maxsize=256)
def parsed_unit(unit: str) -> Any:
    """Return a text as a unit of pint, None where it is none.

    >>> str(parsed_unit("N m")), parsed_unit("widgets")
    ('meter * newton', None)
    """
    try:
        return unit_registry().Unit(unit.replace("^", "**"))
    except Exception:  # pint has a class of its own for every way of misspelling a unit
        return None


@lru_cache(maxsize=256)
def is_acceleration(unit: str) -> bool:
    """Whether a unit is one of an acceleration, along a line or of an angle.

    >>> is_acceleration("mm/s^2"), is_acceleration("rad/s/s"), is_acceleration("m/s"), is_acceleration("")
    (True, True, False, False)
    """
    known = parsed_unit(unit)
    return known is not None and known.dimensionality in [unit_registry().Unit(a).dimensionality for a in ("m/s^2", "rad/s^2")]


def unit_in_words(unit: str) -> str:
    """Return what a unit is read as, or that it is not known.

    >>> unit_in_words("rpm"), unit_in_words("N m"), unit_in_words("revs/m")
    ('revolution / minute', 'meter * newton', 'revs/m, a unit that is not known')
    """
    known = parsed_unit(unit)
    return f"{unit}, a unit that is not known" if known is None else str(known).replace("revolutions_per_minute", "revolution / minute")


def unknown_unit(unit: str) -> str:
    """Return what is wrong with a unit and which one may be meant, "" where it is known.

    >>> unknown_unit("rmp"), unknown_unit("rpm")
    ("unit 'rmp' is not known; expected one such as 'rpm'", '')
    """
    if parsed_unit(unit) is not None:
        return ""
    near = get_close_matches(unit, COMMON, 1)
    return f"unit '{unit}' is not known; expected one such as " + (f"'{near[0]}'" if near else "'mm', 'N' or 'rad/s'")


def is_velocity(unit: str) -> bool:
    """Return whether a unit is that of a linear or angular velocity ("m/s", "rad/s", "rpm"); False for units not known.

    >>> is_velocity("rpm"), is_velocity("m"), is_velocity("widgets")
    (True, False, False)
    """
    known = parsed_unit(unit)
    return known is not None and any(known.dimensionality == unit_registry().get_dimensionality(d) for d in _VELOCITIES) and unit not in ("Hz", "1/s")
