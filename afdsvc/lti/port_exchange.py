"""Exchanging inputs with outputs of a system: one pivot that turns R into J_K, J_G and their relatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from afdsvc.lti.algebraic_loop import solve_loop
from afdsvc.lti.statespace import Array, StateSpace


def exchange(system: StateSpace, inputs: Sequence[int], outputs: Sequence[int]) -> StateSpace:
    """Return the same relation between signals, solved the other way for the listed pairs.

    Output ``outputs[i]`` becomes the input at position ``inputs[i]`` and the other way round; everything else keeps its
    place. The order does not change. Raises `IllConditioned` when the feedthrough between the pairs is not invertible.
    """
    n = system.order
    rows, cols = n + np.asarray(outputs, np.intp), n + np.asarray(inputs, np.intp)
    M = np.block([[system.A, system.B], [system.C, system.D]])
    pivoted = _pivot(M, rows, cols)
    return StateSpace(pivoted[:n, :n], pivoted[:n, n:], pivoted[n:, :n], pivoted[n:, n:], system.dt)


def _pivot(M: Array, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Array:
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
