"""The functions of a Python simulator as they are called everywhere: arrays in, arrays out, and one sentence where they fail."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

Function = Callable[[float, Array, Array, Array], Array]


class Values(dict[str, float]):
    """Parameter values by name, ``p["mass"]`` or ``p.mass``; ``p | {"mass": 2.0}`` are the same with another mass."""

    def __getattr__(self, name: str) -> float:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def __or__(self, other: Any) -> Any:
        return Values({**self, **other})


def array_function(model: Model, which: str, size: int) -> Function:
    """Return f or h of a model as a function ``(t, x (n,), u (m,), values of all parameters) -> (size,)``; where it divides by zero or overflows it gives nan.

    Raises `BadInput` with the reason where the code fails or returns another number of values.
    """
    function, names = getattr(model.dynamics, which), tuple(model.parameters)

    def call(t: float, x: Array, u: Array, values: Array) -> Array:
        try:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                returned = function(t, x.copy(), u.copy(), Values(zip(names, values.tolist(), strict=True)))
                result: Array = np.asarray([] if returned is None else returned, dtype=np.float64)
        except (ArithmeticError, ValueError) as error:
            if isinstance(error, ValueError) and "math domain" not in str(error):
                raise _failed(model, which, error) from error
            return np.full(size, np.nan)
        except Exception as error:
            raise _failed(model, which, error) from error
        if result.size != size:
            raise BadInput(f"model '{model.name}': {which}(t, x, u, p) returned {result.size} values; expected {size}")
        return result.reshape(size)

    return call


def _failed(model: Model, which: str, error: Exception) -> BadInput:
    return BadInput(f"model '{model.name}': {which}(t, x, u, p) fails with {type(error).__name__}: {error}")
