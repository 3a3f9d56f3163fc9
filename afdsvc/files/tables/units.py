"""Conversion of units by pint; ambiguous units are refused."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


def converted(values: Array, source: str, target: str, where: str) -> Array:
    """Return the values in the unit ``target``; the same array where the two are one unit.

    Raises `BadInput`, beginning with ``where``, for an unknown unit, for two units of different dimension, and for Hz on
    one side and an angle on the other: a frequency is no angular speed, and which of the two was meant is not in the numbers.
    """
    if same_unit(source, target, where):
        return values
    _refuse_unlike(source, target, where)
    try:
        return np.asarray(_registry().Quantity(values, source).to(target).magnitude, dtype=np.float64)
    except Exception as error:
        raise BadInput(f"{where}: '{source}' cannot become '{target}': {error}") from None


def same_unit(one: str, other: str, where: str) -> bool:
    """Whether two units are the same one, however spelt; raises `BadInput` for an unknown one."""
    return one == other or bool(_unit(one, where) == _unit(other, where))


def product(one: str, other: str, where: str) -> str:
    """Return the unit of a product, such as N from A and N/A."""
    return f"{(_unit(one, where) * _unit(other, where)):~}"


def _refuse_unlike(source: str, target: str, where: str) -> None:
    units = [_unit(text, where) for text in (source, target)]
    if units[0].dimensionality != units[1].dimensionality:
        raise BadInput(f"{where}: '{source}' cannot become '{target}': their dimensions differ")
    frequency = ["hertz" in str(u) for u in units]
    if frequency[0] != frequency[1]:
        raise BadInput(
            f"{where}: '{source}' and '{target}' differ by 2 pi or not, depending on who wrote it; "
            "expected 'cycle/s' for turns per second or 'rad/s' instead of Hz"
        )


def _unit(text: str, where: str) -> Any:
    try:
        return _registry().Unit(text)
    except Exception as error:  # pint has a class of its own for every way of misspelling a unit
        raise BadInput(f"{where}: unit '{text}' is not known ({type(error).__name__}); expected one such as 'mm', 'N' or 'rad/s'") from None


@lru_cache(maxsize=1)
def _registry() -> Any:
    from pint import UnitRegistry  # a third of a second, for those who convert

    return UnitRegistry()
