"""Linear time-invariant systems as four arrays and a sample time, and the algebra of wiring them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afdsvc.errors import BadInput, IllConditioned

Array = NDArray[np.float64]
LIMIT = 1e12


def solve_loop(matrix: Array) -> Array:
    """Return the inverse of the matrix of an algebraic loop; raises `IllConditioned` with its condition number."""
    if not matrix.size:
        return np.zeros_like(matrix)
    condition = _loop_condition(matrix)
    if not condition < LIMIT:
        raise IllConditioned(
            f"the feedthrough around a loop is singular (condition number {condition:.2g}, expected below {LIMIT:.0g}): "
            "the loop is not well posed; change a feedthrough or add a delay"
        )
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _loop_condition(matrix: Array) -> float:
    """Return the condition number after scaling rows and columns to like size."""
    even = matrix
    for _ in range(5):
        rows, columns = np.abs(even).max(axis=1, keepdims=True), np.abs(even).max(axis=0, keepdims=True)
        even = even / np.sqrt(np.where(rows > 0, rows, 1.0)) / np.sqrt(np.where(columns > 0, columns, 1.0))
    return float(np.linalg.cond(even))


ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """A proper linear system ``x+ = A x + B u, y = C x + D u`` (``dt > 0``) or ``dx/dt = ...`` (``dt == 0``).

    Shapes: ``A (n, n)``, ``B (n, m)``, ``C (p, n)``, ``D (p, m)``; ``n`` may be 0. Build one with `StateSpace.of`,
    which checks shapes and values; ``dt`` is in seconds.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float = 0.0

    @classmethod
    def of(cls, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, dt: float = 0.0) -> StateSpace:
        """Return a checked system; raises `BadInput` naming the matrix, the shape found and the shape expected."""
        a, b, c = _matrix("A", A), _matrix("B", B), _matrix("C", C)
        if a.size == 0:
            a = np.zeros((0, 0))
        n = a.shape[0]
        if a.shape != (n, n):
            raise BadInput(f"matrix A has shape {a.shape}; expected a square matrix")
        if n == 0:
            d = _matrix("D", D if D is not None else np.zeros((c.shape[0], b.shape[1])))
            return cls(a, np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0)), d, _sample_time(dt))
        d = np.zeros((c.shape[0], b.shape[1])) if D is None else _matrix("D", D)
        _expect("B", b, (n, d.shape[1]))
        _expect("C", c, (d.shape[0], n))
        return cls(a, b, c, d, _sample_time(dt))

    @classmethod
    def gain(cls, D: ArrayLike, dt: float = 0.0) -> StateSpace:
        """Return the static system ``y = D u``."""
        d = _matrix("D", D)
        return cls(np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0)), d, _sample_time(dt))

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])

    @property
    def inputs(self) -> int:
        """Number of inputs m."""
        return int(self.D.shape[1])

    @property
    def outputs(self) -> int:
        """Number of outputs p."""
        return int(self.D.shape[0])

    @property
    def discrete(self) -> bool:
        """Whether the system is in discrete time."""
        return self.dt > 0

    def poles(self) -> ComplexArray:
        """Return the eigenvalues of A, shape ``(n,)``."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128) if self.order else np.zeros(0, complex)

    def stability_margin(self) -> float:
        """Return ``1 - max|z|`` (discrete) or ``-max Re s`` (continuous); positive when stable, inf without states."""
        if not self.order:
            return float("inf")
        poles = self.poles()
        return float(1 - np.abs(poles).max()) if self.discrete else float(-poles.real.max())

    def is_stable(self) -> bool:
        """Whether every pole lies strictly inside the stability region."""
        return self.stability_margin() > 0

    def select(self, outputs: Sequence[int] | slice, inputs: Sequence[int] | slice) -> StateSpace:
        """Return the subsystem from the given inputs to the given outputs, in that order."""
        rows = np.arange(self.outputs)[outputs if isinstance(outputs, slice) else list(outputs)]
        cols = np.arange(self.inputs)[inputs if isinstance(inputs, slice) else list(inputs)]
        return StateSpace(self.A, self.B[:, cols], self.C[rows], self.D[np.ix_(rows, cols)], self.dt)

    def __neg__(self) -> StateSpace:
        return StateSpace(self.A, self.B, -self.C, -self.D, self.dt)

    def __matmul__(self, first: StateSpace) -> StateSpace:
        """Series ``self @ first``: the input goes through ``first``, then through ``self``."""
        dt = common_dt(self, first)
        if self.inputs != first.outputs:
            raise BadInput(f"series needs equal widths; {first.outputs} outputs meet {self.inputs} inputs")
        A = np.block([[first.A, np.zeros((first.order, self.order))], [self.B @ first.C, self.A]])
        B = np.vstack([first.B, self.B @ first.D])
        C = np.hstack([self.D @ first.C, self.C])
        return StateSpace(A, B, C, self.D @ first.D, dt)

    def __add__(self, other: StateSpace) -> StateSpace:
        """Parallel sum of two systems with the same inputs and outputs."""
        if self.D.shape != other.D.shape:
            raise BadInput(f"a sum needs equal shapes; {self.D.shape} meets {other.D.shape}")
        both = block_diagonal(self, other)
        return StateSpace(both.A, np.vstack([self.B, other.B]), np.hstack([self.C, other.C]), self.D + other.D, both.dt)

    def __sub__(self, other: StateSpace) -> StateSpace:
        return self + (-other)

    def inverse(self) -> StateSpace:
        """Return the inverse system of a square system with invertible D; raises `IllConditioned` otherwise."""
        if self.inputs != self.outputs:
            raise BadInput(f"only a square system has an inverse; this one is {self.outputs} x {self.inputs}")
        Di = solve_loop(self.D)
        return StateSpace(self.A - self.B @ Di @ self.C, self.B @ Di, -Di @ self.C, Di, self.dt)


def common_dt(*systems: StateSpace) -> float:
    """Return the sample time the systems share (static gains of dt 0 fit any); raises `BadInput` when they differ."""
    times = {s.dt for s in systems if s.order or s.dt}
    if len(times) > 1:
        raise BadInput(f"systems with sample times {sorted(times)} s cannot be joined; expected one sample time")
    return times.pop() if times else 0.0


def block_diagonal(*systems: StateSpace) -> StateSpace:
    """Return the systems side by side: inputs and outputs stacked in order."""
    dt = common_dt(*systems)

    def diag(blocks: list[Array]) -> Array:
        out = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
        r = c = 0
        for b in blocks:
            out[r : r + b.shape[0], c : c + b.shape[1]] = b
            r, c = r + b.shape[0], c + b.shape[1]
        return out

    return StateSpace(
        diag([s.A for s in systems]),
        diag([s.B for s in systems]),
        diag([s.C for s in systems]),
        diag([s.D for s in systems]),
        dt,
    )


def _matrix(name: str, value: Any) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.ndim > 2:
        raise BadInput(f"matrix {name} has {array.ndim} dimensions; expected two")
    array = np.atleast_2d(array) if array.size else array.reshape(array.shape if array.ndim == 2 else (0, 0))
    if not np.isfinite(array).all():
        raise BadInput(f"matrix {name} contains NaN or infinity; expected finite numbers")
    return array


def _expect(name: str, value: Array, shape: tuple[int, int]) -> None:
    if value.shape != shape:
        raise BadInput(f"matrix {name} has shape {value.shape}; expected {shape} to fit A and D")


def _sample_time(dt: float) -> float:
    if not (np.isfinite(dt) and dt >= 0):
        raise BadInput(f"sample time {dt} s; expected a positive number, or 0 for continuous time")
    return float(dt)
