"""Exchanging inputs with outputs of a system: one pivot that turns R into J_K, J_G and their relatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.errors import IllConditioned
from afdsvc.lti.statespace import Array, StateSpace

PIVOT_LIMIT = 1e12


def exchange(system: StateSpace, inputs: Sequence[int], outputs: Sequence[int]) -> StateSpace:
    """Return the same relation between signals, solved the other way for the listed pairs.

    Output ``outputs[i]`` becomes the input at position ``inputs[i]`` and the other way round; everything else keeps its
    place. The order does not change. Raises `IllConditioned` when the feedthrough between the pairs is not invertible.
    """
    n = system.order
    rows, cols = n + np.asarray(outputs, int), n + np.asarray(inputs, int)
    M = np.block([[system.A, system.B], [system.C, system.D]])
    pivoted = _pivot(M, rows, cols)
    return StateSpace(pivoted[:n, :n], pivoted[:n, n:], pivoted[n:, :n], pivoted[n:, n:], system.dt)


def _pivot(M: Array, rows: Array, cols: Array) -> Array:
    """Solve ``out = M in`` for the inputs ``cols`` in terms of the outputs ``rows`` (principal pivot transform)."""
    other_rows, other_cols = np.setdiff1d(np.arange(M.shape[0]), rows), np.setdiff1d(np.arange(M.shape[1]), cols)
    inverse = solve_loop(M[np.ix_(rows, cols)])
    out = np.empty_like(M)
    from_rest = -inverse @ M[np.ix_(rows, other_cols)]
    through = M[np.ix_(other_rows, cols)]
    out[np.ix_(rows, cols)] = inverse
    out[np.ix_(rows, other_cols)] = from_rest
    out[np.ix_(other_rows, cols)] = through @ inverse
    out[np.ix_(other_rows, other_cols)] = M[np.ix_(other_rows, other_cols)] + through @ from_rest
    return out


def solve_loop(matrix: Array) -> Array:
    """Return the inverse of the matrix of an algebraic loop; raises `IllConditioned` with its condition number."""
    if not matrix.size:
        return np.zeros_like(matrix)
    scaled = matrix / np.maximum(np.abs(matrix).max(axis=1, keepdims=True), np.finfo(float).tiny)
    condition = np.linalg.cond(scaled)
    if not condition < PIVOT_LIMIT:
        raise IllConditioned(
            f"the feedthrough around a loop is singular (condition number {condition:.2g}, below {PIVOT_LIMIT:.0g} is "
            "wanted): the loop is not well posed; change a feedthrough or add a delay"
        )
    return np.linalg.inv(matrix)
