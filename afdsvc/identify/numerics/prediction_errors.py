"""One pass over a recording: prediction errors and their derivatives, reduced on the way to normal equations.

The sensitivities of the state are simulated forward together with it, all parameters side by side, so the cost of a
full Gauss-Newton step grows linearly with samples and with parameters and no sensitivity is ever stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy import linalg

from afdsvc.identify.parameters.noise_structure import Slopes
from afdsvc.lti.statespace import Array, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """What a pass leaves: ``cost = sum rho(e)``, gradient ``(q + n,)`` and Gauss-Newton matrix ``(q + n, q + n)``.

    The last n rows belong to the initial state (fewer when fewer are unknown). ``spread (p, p)`` is ``sum e e'`` of the errors as they are;
    ``gradients (blocks, q + n)`` add up to the gradient, block of samples by block of samples.
    """

    cost: float
    gradient: Array
    matrix: Array
    spread: Array
    samples: int
    gradients: Array


def sweep(
    system: StateSpace,
    slopes: Slopes,
    inputs: Array,
    outputs: Array,
    x0: Array,
    whitener: Array,
    one_norm: float = 0.0,
    block: int = 2048,
    skip: int = 0,
    free: int | None = None,
) -> NormalEquations:
    """Return the normal equations of ``e = whitener (outputs - system(inputs))``.

    ``inputs (N, m)``, ``outputs (N, p)``, ``x0 (n,)``, ``whitener (p, p)``. Without ``one_norm`` the cost is half the
    sum of squares; with it the sum of ``|e|``, rounded off below ``one_norm`` (Huber's function). The first ``skip``
    samples run through the system and are not counted. ``free``: only so many of the last states start unknown.
    """
    q, n, p = len(slopes.A), system.order, system.outputs
    f = n if free is None else free
    x, X = x0.copy(), np.zeros((n, q + f))
    X[n - f :, q:] = np.eye(f)
    A, B, C, D, dA, dB, dC, dD = _pack(system, slopes)
    cost, gradients, matrix, spread = 0.0, [], np.zeros((q + f, q + f)), np.zeros((p, p))
    errors, jacobian = np.empty((block, p)), np.empty((block, p, q + f))
    for start in range(0, len(outputs), block):
        v, y = inputs[start : start + block], outputs[start : start + block]
        count = len(y)
        _step(A, B, C, D, dA, dB, dC, dD, np.ascontiguousarray(v), np.ascontiguousarray(y), x, X, errors, jacobian)
        e, J = errors[:count], jacobian[:count]
        unseen = min(max(skip - start, 0), count)
        e[:unseen], J[:unseen] = 0.0, 0.0
        spread += e.T @ e
        white = (e @ whitener.T).ravel()
        rows = np.matmul(whitener, J).reshape(count * p, q + f)
        weight, value = _weights(white, one_norm)
        cost += value
        gradients.append(rows.T @ (weight * white))
        matrix += rows.T @ (rows * weight[:, None])
    parts = np.stack(gradients)
    return NormalEquations(cost, parts.sum(axis=0), matrix, spread, len(outputs) - min(skip, len(outputs)), parts)


def responses(system: StateSpace, slopes: Slopes, inputs: Array) -> tuple[Array, Array]:
    """Return the outputs ``(N, p)`` from rest and their slopes ``(N, p, q)``."""
    q, n, p, count = len(slopes.A), system.order, system.outputs, len(inputs)
    A, B, C, D, dA, dB, dC, dD = _pack(system, slopes)
    errors, jacobian = np.empty((count, p)), np.empty((count, p, q))
    _step(
        A,
        B,
        C,
        D,
        dA,
        dB,
        dC,
        dD,
        np.ascontiguousarray(inputs),
        np.zeros((count, p)),
        np.zeros(n),
        np.zeros((n, q)),
        errors,
        jacobian,
    )
    return -errors, -jacobian


def eliminate_state(found: NormalEquations, count: int, x0: Array) -> tuple[float, Array, Array, Array]:
    """Fit the initial state and return cost, gradient, curvature of the first ``count`` parameters and the state.

    It enters the errors linearly, so this is exact for the 2-norm.
    """
    g, H = found.gradient, found.matrix
    Hxx = H[count:, count:] + 1e-12 * max(float(np.trace(H[count:, count:])), 1e-300) * np.eye(len(x0))
    solved = np.linalg.solve(Hxx, np.column_stack([g[count:], H[count:, :count]]))
    shift, coupling = solved[:, 0], solved[:, 1:]
    cost = found.cost - 0.5 * float(g[count:] @ shift)
    return cost, g[:count] - H[:count, count:] @ shift, H[:count, :count] - H[:count, count:] @ coupling, x0 - shift


def whitening_of(covariance: Array) -> Array:
    """Return W with ``W covariance W' = I``."""
    return np.asarray(linalg.solve_triangular(np.linalg.cholesky(covariance), np.eye(len(covariance)), lower=True))


def _weights(white: Array, one_norm: float) -> tuple[Array, float]:
    if not one_norm:
        return np.ones_like(white), 0.5 * float(white @ white)
    size = np.abs(white)
    inside = size < one_norm
    value = np.where(inside, size**2 / (2 * one_norm) + one_norm / 2, size)
    return 1 / np.maximum(size, one_norm), float(value.sum())


def _pack(system: StateSpace, slopes: Slopes) -> tuple[Array, ...]:
    """Lay the matrices out for the loop: slopes with the parameter running fastest."""
    return (
        *map(np.ascontiguousarray, (system.A, system.B, system.C, system.D)),
        *(np.ascontiguousarray(np.moveaxis(s, 0, -1)) for s in (slopes.A, slopes.B, slopes.C, slopes.D)),
    )


@njit(cache=True, fastmath=True)
def _advance(M: Any, slope: Any, moves: Any, x: Any, X: Any, i: int, sign: float, row: Any) -> Any:
    """Add ``sign (M X + slope x)`` of row i to ``row`` and return row i of ``M x``; zero entries and slopes (not ``moves``) cost nothing."""
    total, q = 0.0, slope.shape[2]
    for j in range(M.shape[1]):
        entry, value = M[i, j], sign * x[j]
        if entry != 0.0:
            total += entry * x[j]
            factor = sign * entry
            for s in range(X.shape[1]):
                row[s] += factor * X[j, s]
        if moves[i, j]:
            for s in range(q):
                row[s] += slope[i, j, s] * value
    return total


@njit(cache=True)
def _moving(slope: Any) -> Any:
    """Return which entries of a matrix move with any parameter."""
    moving = np.zeros(slope.shape[:2], dtype=np.bool_)
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            moving[i, j] = np.any(slope[i, j] != 0.0)
    return moving


@njit(cache=True, fastmath=True)
def _step(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    dA: Any,
    dB: Any,
    dC: Any,
    dD: Any,
    v: Any,
    y: Any,
    x: Any,
    X: Any,
    errors: Any,
    jacobian: Any,
) -> None:
    """Advance state x ``(n,)`` and sensitivities X ``(n, q + free)``; fill errors and their derivatives."""
    (n, columns), (p, m) = X.shape, D.shape
    moves_A, moves_B, moves_C, moves_D = _moving(dA), _moving(dB), _moving(dC), _moving(dD)
    new_x, new_X, known = np.empty(n), np.empty((n, columns)), np.zeros((m, 0))
    for k in range(v.shape[0]):
        for i in range(p):
            jacobian[k, i] = 0.0
            predicted = _advance(C, dC, moves_C, x, X, i, -1.0, jacobian[k, i])
            errors[k, i] = y[k, i] - predicted - _advance(D, dD, moves_D, v[k], known, i, -1.0, jacobian[k, i])
        for i in range(n):
            new_X[i] = 0.0
            new_x[i] = _advance(A, dA, moves_A, x, X, i, 1.0, new_X[i])
            new_x[i] += _advance(B, dB, moves_B, v[k], known, i, 1.0, new_X[i])
        x[:] = new_x
        X[:, :] = new_X
