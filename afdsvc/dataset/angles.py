"""Angles that a sensor reads within one turn: the reading jumps by a turn where it begins anew."""

from __future__ import annotations

import numpy as np

from afdsvc.dataset.units import parsed_unit, unit_registry
from afdsvc.lti.statespace import Array

SPAN = 1.02  # turns that a reading within one turn may span, for its noise
LONGEST = 0.25  # turns between two samples, else a jump cannot be distinguished from motion


def turn(unit: str) -> float:
    """Return one turn in a unit of angle, 0 for any other unit.

    >>> turn("deg"), turn("turn"), turn("mm"), turn("")
    (360.0, 1.0, 0.0, 0.0)
    """
    known = parsed_unit(unit)
    if known is None or not known.dimensionless or not any(word in str(known) for word in ("radian", "degree", "turn", "revolution")):
        return 0.0
    return round(float(unit_registry().Quantity(1.0, "turn").to(known).magnitude), 12)


def unwrapped(x: Array, one: float) -> tuple[Array, int]:
    """Return a reading ``(n,)`` without its jumps by ``one`` turn, and how many there were; NaN where missing.

    Two samples that are more than half a turn apart are a jump. The reading stays as it is where it spans more than a turn, or where without the
    jumps it moves by more than a quarter of a turn between two samples.
    """
    seen = np.flatnonzero(np.isfinite(x))
    jumps = int((np.abs(np.diff(x[seen])) > one / 2).sum()) if one else 0
    if not jumps or np.ptp(x[seen]) > SPAN * one:
        return x, 0
    smooth = np.unwrap(x[seen], period=one)
    if np.abs(np.diff(smooth)).max() > LONGEST * one:
        return x, 0
    found = x.copy()
    found[seen] = smooth
    return found, jumps
