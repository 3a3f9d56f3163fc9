"""Solving algebraic loops, with a condition number that does not depend on the units of the signals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afdsvc.errors import IllConditioned

Array = NDArray[np.float64]
LIMIT = 1e12


def solve_loop(matrix: Array) -> Array:
    """Return the inverse of the matrix of an algebraic loop; raises `IllConditioned` with its condition number."""
    if not matrix.size:
        return np.zeros_like(matrix)
    condition = loop_condition(matrix)
    if not condition < LIMIT:
        raise IllConditioned(
            f"the feedthrough around a loop is singular (condition number {condition:.2g}, expected below {LIMIT:.0g}): "
            "the loop is not well posed; change a feedthrough or add a delay"
        )
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def loop_condition(matrix: Array) -> float:
    """Return the condition number after scaling rows and columns to like size."""
    even = matrix
    for _ in range(5):
        rows, columns = np.abs(even).max(axis=1, keepdims=True), np.abs(even).max(axis=0, keepdims=True)
        even = even / np.sqrt(np.where(rows > 0, rows, 1.0)) / np.sqrt(np.where(columns > 0, columns, 1.0))
    return float(np.linalg.cond(even))
