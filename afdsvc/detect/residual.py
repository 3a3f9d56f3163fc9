"""The residual as a stream: the innovations filter applied sample by sample.

Sums run in a fixed order inside one compiled loop, so the residual is the same to the last bit however the samples are cut
into blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace


@njit(cache=True)
def run_filter(A, B, C, D, x, inputs, outputs):  # type: ignore[no-untyped-def]
    """Advance ``x`` in place over ``inputs (n, m)`` and write ``outputs (n, p)``."""
    order, m, p = x.size, inputs.shape[1], outputs.shape[1]
    new = np.zeros(order)
    for k in range(inputs.shape[0]):
        for i in range(p):
            s = 0.0
            for j in range(order):
                s += C[i, j] * x[j]
            for j in range(m):
                s += D[i, j] * inputs[k, j]
            outputs[k, i] = s
        for i in range(order):
            s = 0.0
            for j in range(order):
                s += A[i, j] * x[j]
            for j in range(m):
                s += B[i, j] * inputs[k, j]
            new[i] = s
        for i in range(order):
            x[i] = new[i]


@dataclass(frozen=True, slots=True, eq=False)
class StreamingFilter:
    """A discrete system whose state is a value: ``step(state, inputs) -> (state, outputs)``."""

    system: StateSpace

    def __post_init__(self) -> None:
        if self.system.order and not self.system.discrete:
            raise BadInput("a continuous-time system cannot filter samples; a discrete one (dt > 0) is wanted")

    def start(self) -> Array:
        """Return the state at rest, shape ``(order,)``."""
        return np.zeros(self.system.order)

    def step(self, state: Array, inputs: Array) -> tuple[Array, Array]:
        """Return the state after the samples ``inputs (n, inputs)`` and the outputs ``(n, outputs)``."""
        s = self.system
        if inputs.ndim != 2 or inputs.shape[1] != s.inputs:
            raise BadInput(f"filter got an array of shape {inputs.shape}; (samples, {s.inputs}) is wanted")
        x, outputs = state.copy(), np.empty((len(inputs), s.outputs))
        run_filter(*_dense(s), x, np.ascontiguousarray(inputs, dtype=np.float64), outputs)
        return x, outputs

    def settling(self, to: float = 1e-4) -> int:
        """Return after how many samples what the filter started with has decayed to the share ``to``."""
        return decay(self.system, to)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualFilter:
    """The filter from ``[y; u]`` to the white residual r: ``xh+ = (A - Kp C) xh + (B - Kp D) u + Kp y, r = y - C xh - D u``.

    ``innovations`` is that filter with p outputs; ``step(state, y, u) -> (state, r)`` with y ``(n, p)``, u ``(n, m)``.
    NaN in the input stays in the state of a filter with Kp other than 0: start again after it.
    """

    innovations: StateSpace

    def start(self) -> Array:
        """Return the state at rest."""
        return StreamingFilter(self.innovations).start()

    def step(self, state: Array, y: Array, u: Array) -> tuple[Array, Array]:
        """Return the state after the block and the residual r, shape ``(n, p)``."""
        return StreamingFilter(self.innovations).step(state, np.hstack([y, u]))


def decay(system: StateSpace, to: float = 1e-4) -> int:
    """Return the samples after which the slowest mode of a stable system has decayed to the share ``to`` (0 if static)."""
    if not system.order:
        return 0
    slowest = float(np.abs(system.poles()).max())
    if slowest >= 1:
        raise BadInput(f"the system has a pole of modulus {slowest:.6g}; a stable one is wanted")
    return 1 if slowest < 1e-12 else int(np.ceil(np.log(to) / np.log(slowest)))


def _dense(s: StateSpace) -> tuple[Array, Array, Array, Array]:
    return tuple(np.ascontiguousarray(M, dtype=np.float64) for M in (s.A, s.B, s.C, s.D))  # type: ignore[return-value]
