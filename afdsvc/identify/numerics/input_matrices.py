"""B, D and the initial states by linear regression, once A, C (and the predictor gain K) are known.

With A, C, K fixed the prediction error is linear in the rest:

    e = y - C (zI - At)^-1 K y - C (zI - At)^-1 (Bt u) - D u - C At^k x0,     At = A - K C,  Bt = B - K D

so ordinary least squares is exact, whatever the colour of the noise (Verhaegen and Verdult, Filtering and System
Identification, 2007, section 9.5). ``K = 0`` minimises the simulation error; a stabilising K serves unstable A too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from scipy import linalg

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.numerics.compression import factor_of, join
from afdsvc.lti.statespace import Array

_BLOCK = 4096


def regress_input_matrices(
    A: Array, C: Array, recordings: Sequence[InputOutputData], K: Array | None = None, feedthrough: bool = True
) -> tuple[Array, Array]:
    """Return ``B (n, m)`` and ``D (p, m)`` (zero without ``feedthrough``); initial states are eliminated per
    recording."""
    n, p, m = A.shape[0], C.shape[0], recordings[0].u.shape[1]
    gain = np.zeros((n, p)) if K is None else K
    # The first n columns are the free response; the rows below have the initial state projected out.
    factors = [factor_of(partial(_blocks, A - gain @ C, C, gain, r, feedthrough))[n:, n:] for r in recordings]
    factor = factors[0] if len(factors) == 1 else join(factors)
    solution = linalg.lstsq(factor[:, :-1], factor[:, -1])[0]
    Bt = solution[: n * m].reshape(m, n).T
    D = solution[n * m :].reshape(p, m) if feedthrough else np.zeros((p, m))
    return np.asarray(Bt + gain @ D), np.asarray(D)


def _blocks(At: Array, C: Array, K: Array, recording: InputOutputData, feedthrough: bool) -> Iterator[Array]:
    state = _State(At.shape[0], C.shape[0], recording.u.shape[1], C)
    for start in range(0, len(recording), _BLOCK):
        yield _rows(At, C, K, recording.span(start, start + _BLOCK), state, feedthrough)


class _State:
    """What the filters remember between blocks."""

    def __init__(self, n: int, p: int, m: int, C: Array) -> None:
        self.forced: Array = np.zeros((p, m, n))
        self.measured: Array = np.zeros(n)
        self.free: Array = C.copy()


def _rows(At: Array, C: Array, K: Array, block: InputOutputData, state: _State, feedthrough: bool) -> Array:
    (count, m), p, n = block.u.shape, C.shape[0], At.shape[0]
    At, C, K = np.ascontiguousarray(At), np.ascontiguousarray(C), np.ascontiguousarray(K)
    free, forced, predicted = np.empty((count, p, n)), np.empty((count, p, m, n)), np.empty((count, p))
    _filters(At, C, K, block.u, block.y, state.free, state.forced, state.measured, free, forced, predicted)
    parts = [free, forced.reshape(count, p, m * n)]
    if feedthrough:
        direct = np.zeros((count, p, p * m))
        for row in range(p):
            direct[:, row, row * m : (row + 1) * m] = block.u
        parts.append(direct)
    parts.append((block.y - predicted)[:, :, None])
    stacked = np.concatenate(parts, axis=2)
    return stacked.reshape(count * p, stacked.shape[2])


@njit(cache=True)
def _dot(a: Any, b: Any) -> Any:
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _back(At: Any, row: Any, new: Any) -> float:
    """Put ``row At`` into ``new`` and return its largest entry."""
    biggest = 0.0
    for i in range(At.shape[0]):
        total = 0.0
        for j in range(At.shape[0]):
            total += row[j] * At[j, i]
        new[i] = total
        biggest = max(biggest, abs(total))
    return biggest


@njit(cache=True)
def _filters(
    At: Any,
    C: Any,
    K: Any,
    u: Any,
    y: Any,
    free: Any,
    forced: Any,
    measured: Any,
    free_out: Any,
    forced_out: Any,
    predicted: Any,
) -> None:
    """Step the transposed filters ``xi+ = At^T xi + c_l u_j``, the free response ``C At^k`` and the part driven by
    y."""
    p, n = C.shape
    new = np.empty(n)
    for k in range(u.shape[0]):
        for row in range(p):
            free_out[k, row] = free[row]
            # Denormal numbers would make this loop ten times slower long after the response has died out.
            alive = 1.0 if _back(At, free[row], new) > 1e-100 else 0.0
            for i in range(n):
                free[row, i] = alive * new[i]
            predicted[k, row] = _dot(C[row], measured)
            for c in range(u.shape[1]):
                forced_out[k, row, c] = forced[row, c]
                _back(At, forced[row, c], new)
                for i in range(n):
                    forced[row, c, i] = new[i] + C[row, i] * u[k, c]
        for i in range(n):
            new[i] = _dot(At[i], measured) + _dot(K[i], y[k])
        measured[:] = new
