"""Running discrete systems over samples: bit-identical however the samples are cut into blocks.

Every sum is built in the same order for every sample, so filtering one block after another with the state carried over
gives exactly the numbers of one pass over the whole, and the loop without numba gives them too.
"""

from __future__ import annotations

import numba
import numpy as np

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace


def simulate(system: StateSpace, u: Array, x0: Array | None = None) -> tuple[Array, Array]:
    """Return ``y (k, p)`` and the state after the last sample ``(n,)`` for inputs ``u (k, m)``, starting from ``x0``.

    ``x+ = A x + B u, y = C x + D u``; ``x0`` is zero when left out. Raises `BadInput` for wrong shapes and for a
    continuous system with states (sample it first).
    """
    u, x = _checked(system, u, x0)
    y = np.empty((u.shape[0], system.outputs))
    _run(*_columns(system), u, x, y)
    return y, x


def _checked(system: StateSpace, u: Array, x0: Array | None) -> tuple[Array, Array]:
    if system.order and not system.discrete:
        raise BadInput("a continuous system cannot run over samples; sample it with afdsvc.lti.sampling.sample_zoh")
    u = np.ascontiguousarray(u, dtype=np.float64)
    if u.ndim != 2 or u.shape[1] != system.inputs:
        raise BadInput(f"inputs of shape {u.shape}; expected (samples, {system.inputs})")
    x = np.zeros(system.order) if x0 is None else np.array(x0, dtype=np.float64)
    if x.shape != (system.order,):
        raise BadInput(f"initial state of shape {x.shape}; expected ({system.order},)")
    return u, x


def _columns(system: StateSpace) -> tuple[Array, Array, Array, Array]:
    """Return the matrices transposed, so that row j holds what state or input j adds."""
    return tuple(np.ascontiguousarray(M.T) for M in (system.A, system.B, system.C, system.D))  # type: ignore[return-value]


@numba.njit(cache=True)
def _run(A: Array, B: Array, C: Array, D: Array, u: Array, x: Array, y: Array) -> None:
    """Advance ``x`` in place and fill ``y``; matrices transposed."""
    n, m, p = A.shape[0], B.shape[0], y.shape[1]
    after = np.zeros(n)
    for k in range(u.shape[0]):
        after[:] = 0.0
        y[k, :] = 0.0
        for j in range(n):
            xj = x[j]
            for i in range(p):
                y[k, i] += C[j, i] * xj
            for i in range(n):
                after[i] += A[j, i] * xj
        for j in range(m):
            uj = u[k, j]
            for i in range(p):
                y[k, i] += D[j, i] * uj
            for i in range(n):
                after[i] += B[j, i] * uj
        x[:] = after
