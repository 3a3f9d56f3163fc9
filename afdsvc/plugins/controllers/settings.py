"""Reading the settings of a plugin: unknown keys are errors, so a misspelt one is never ignored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


def known(settings: Mapping[str, Any], owner: str, *keys: str) -> None:
    """Raise `BadInput` when a key is not among the known ones."""
    for key in settings:
        if key not in keys:
            raise BadInput(f"{owner}: unknown setting '{key}'; known are {', '.join(keys) or 'none'}")


def square(value: Any, size: int, owner: str, key: str) -> Array:
    """Return a weight as a square matrix: from a number, a diagonal, or the matrix itself."""
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return float(array) * np.eye(size)
    if array.ndim == 1 and array.size == size:
        return np.diag(array)
    if array.shape == (size, size):
        return array
    raise BadInput(f"{owner}: setting '{key}' has shape {array.shape}; a number, {size} numbers or a {size} x {size} matrix")
