"""Units as dimensions: what a variable is by its unit."""

from __future__ import annotations

from functools import lru_cache

import pint

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry()
_VELOCITIES = ("[length]/[time]", "1/[time]")


@lru_cache(maxsize=256)
def is_velocity(unit: str) -> bool:
    """Return whether a unit is that of a linear or angular velocity ("m/s", "rad/s", "rpm"); False for units not known.

    >>> is_velocity("rpm"), is_velocity("m"), is_velocity("widgets")
    (True, False, False)
    """
    try:
        return any(_REGISTRY.Quantity(1, unit.replace("^", "**")).check(d) for d in _VELOCITIES) and unit not in ("Hz", "1/s")
    except (pint.errors.PintError, ValueError, TypeError, AttributeError):
        return False
