"""One small filter for the regressors of all faults: ``psi_i[k] = Theta_i f[k]``, however many faults there are.

Every psi_i of `regressors` is a linear filter of the same measured inputs, outputs and predictor. Faults that are linear
combinations of others need no filter of their own, and of the filters left, stacked, only the part that the measured
signals reach ever moves: at most about ``2 n (m + p)`` states for n states of the plant. What is left out is what white
signals move by less than a rounding error; nothing is approximated beyond that.

A burst then needs only ``sum f e'`` and ``sum f f'`` (`products`): the cost per sample does not grow with the faults,
and every score and information follows from the Theta_i when a decision is made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numba import njit
from scipy.linalg import qr

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.innovations import decay
from afdsvc.detect.features.regressors import Regressors, regressors
from afdsvc.lti.statespace import Array, StateSpace

RANK = 1e-13  # share of the largest below which a direction is rounding
DOUBLINGS = 60  # of the horizon over which states are reached
LARGEST = 600  # stacked states up to which a common basis is looked for


@dataclass(frozen=True, slots=True, eq=False)
class SharedRegressors:
    """The filter ``x+ = A x + B [y; u]``, ``f = C x + D u`` behind all regressors, with ``theta (K, p, F)`` so that the
    normalised psi_i is ``theta_i f``; the other attributes are those of `regressors.Regressors`.

    ``At, Bt, Ct, Dt`` are the transposes: the loops run along memory. Build one with `shared`.
    """

    names: tuple[str, ...]
    faults: int
    bounds: tuple[tuple[float, float], ...]
    sd: Array
    exact: tuple[bool, ...]
    plant: StateSpace
    Kp: Array
    Li: Array
    At: Array
    Bt: Array
    Ct: Array
    Dt: Array
    theta: Array
    rest: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "rest", np.zeros(self.order))

    @property
    def order(self) -> int:
        """States of the filter."""
        return int(self.At.shape[0])

    def start(self) -> Array:
        """Return the state at rest, one object for all who ask."""
        return self.rest

    def step(self, state: Array, r: Array, y: Array, u: Array) -> tuple[Array, Array]:
        """Return the state after the block and the series ``(n, 1 + F / p, p)``: normalised residual, then f."""
        p, F = self.plant.outputs, self.theta.shape[2]
        x, series = state.copy(), np.empty((len(r), 1 + F // p, p))
        flat = series.reshape(len(r), p + F)
        _run(self.At, self.Bt, self.Ct, self.Dt, self.Li, x, _rows(r), _rows(np.hstack([y, u])), flat)
        return x, series

    def settling(self, to: float = 1e-4) -> int:
        """Return after how many samples an unknown initial state has decayed to the share ``to``."""
        A = self.plant.A - self.Kp @ self.plant.C
        return decay(StateSpace(A, self.plant.B, self.plant.C, self.plant.D, self.plant.dt), to)


Filters: TypeAlias = Regressors | SharedRegressors


def shared_regressors(problem: DetectionProblem) -> Filters:
    """Return the filter behind the regressors of a problem, one object for all its detectors."""
    return problem.once(lambda: shared(regressors(problem)), "shared regressors")


def shared(filters: Regressors) -> Filters:
    """Return the filter of all regressors together, or the regressors themselves where that would not be cheaper."""
    n, p, K = filters.plant.order, filters.plant.outputs, len(filters.names)
    if not K:
        return filters
    ways, mixture = _distinct(filters)
    if n * (1 + len(ways)) > LARGEST:
        return filters
    A, B, C, D = _stacked(filters, ways, mixture)
    scale, V = _reachable(A, B)
    A, B, C = V.T @ (A * scale / scale[:, None]) @ V, V.T @ (B / scale[:, None]), C * scale @ V
    rows, theta = _features(np.hstack([C, D]))
    if len(V.T) * len(V.T) + rows.size > (1 + K) * n * n + K * p * n:
        return filters
    F = -(-len(rows) // p) * p
    rows, theta = np.pad(rows, ((0, F - len(rows)), (0, 0))), np.pad(theta, ((0, 0), (0, F - len(rows))))
    return SharedRegressors(
        filters.names, filters.faults, filters.bounds, filters.sd, filters.exact, filters.plant, filters.Kp, filters.Li,
        _rows(A.T), _rows(B.T), _rows(rows[:, : len(A)].T), _rows(rows[:, len(A) :].T), theta.reshape(K, p, F),
    )


def _distinct(f: Regressors) -> tuple[Array, Array]:
    """Return distinct ways ``(R, n, n + p + m)`` from ``[x, y, u]`` into error filters, those of R of the faults, and
    every fault's mixture ``(K, R)`` of them.
    """
    K, n, p = f.Kd.shape
    g = f.plant
    into = np.concatenate([f.Bw @ f.Cz - f.Kd @ g.C, f.Kd, f.Bw @ f.Dzu - f.Kd @ g.D], axis=2)
    flat = into.reshape(K, -1)
    typical = np.sqrt(np.mean(flat**2, axis=0))  # units must not decide what is small
    flat = flat / np.where(typical > 0, typical, 1.0)
    length = np.linalg.norm(flat, axis=1)
    unit = flat / np.where(length > 0, length, 1.0)[:, None]
    _, R, order = qr(unit.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    chosen = order[: len(size)][size > RANK * max(size.max(initial=0.0), 1e-300)]
    mixture = np.linalg.lstsq(unit[chosen].T, unit.T, rcond=None)[0].T if len(chosen) else np.zeros((K, 0))
    mixture[chosen] = np.eye(len(chosen))
    return into[chosen], mixture * length[:, None] / length[chosen]


def _predictor(f: Regressors) -> tuple[Array, Array]:
    return f.plant.A - f.Kp @ f.plant.C, np.hstack([f.Kp, f.plant.B - f.Kp @ f.plant.D])


def _stacked(f: Regressors, ways: Array, mixture: Array) -> tuple[Array, Array, Array, Array]:
    """Return predictor and distinct error filters as one system from ``[y, u]`` to all normalised psi, ``(K p)``."""
    (A, B), n, R, g = _predictor(f), f.plant.order, len(ways), f.plant
    C = f.Li @ g.C
    big = np.kron(np.eye(1 + R), A)
    big[n:, :n] = ways[:, :, :n].reshape(R * n, n)
    drive = np.vstack([B, ways[:, :, n:].reshape(R * n, B.shape[1])])
    direct = f.Li @ f.Dyw
    seen = np.concatenate([(direct @ f.Cz)[:, :, None], np.einsum("kr,pn->kprn", mixture, C)], axis=2) if n else None
    rows = len(f.names) * g.outputs
    C = np.zeros((rows, 0)) if seen is None else seen.reshape(rows, (1 + R) * n)
    D = np.asarray((direct @ f.Dzu).reshape(rows, g.inputs))
    return np.asarray(big), drive, C, D


def _reachable(A: Array, B: Array) -> tuple[Array, Array]:
    """Return scales ``(N,)`` and an orthonormal basis ``(N, d)`` of what white inputs move, in states divided by those.

    The factor S of the stationary covariance ``S S'`` is found by doubling (R. A. Smith, *SIAM J. Appl. Math.* 16, 1968)
    and never squared, so that directions are separated from rounding at full precision.
    """
    S, power = B, A
    for _ in range(DOUBLINGS):
        S = np.asarray(np.linalg.qr(np.hstack([S, power @ S]).T, mode="r")).T
        power = power @ power
        if np.linalg.norm(power) < RANK * RANK:
            break
    size = np.linalg.norm(S, axis=1)
    scale = np.where(size > 0, size, 1.0)
    left, s, _ = np.linalg.svd(S / scale[:, None], full_matrices=False)
    return scale, np.asarray(left[:, s > RANK * max(s.max(initial=0.0), 1e-300)])


def _features(theta: Array) -> tuple[Array, Array]:
    """Return orthonormal rows ``(F, q)`` that span those of ``theta (K p, q)``, and theta in them.

    All q coordinates as they are where the rows span nearly everything.
    """
    size = np.linalg.norm(theta, axis=1)
    _, s, Vt = np.linalg.svd(theta / np.where(size > 0, size, 1.0)[:, None], full_matrices=False)
    rows = Vt[s > RANK * max(s.max(initial=0.0), 1e-300)]
    return rows, np.asarray(theta @ rows.T)


def _rows(a: Array) -> Array:
    return np.require(a, np.float64, ("C", "W"))


@njit(cache=True)
def _run(At, Bt, Ct, Dt, Li, x, r, yu, series):  # type: ignore[no-untyped-def]
    p = Li.shape[0]
    new, f = np.zeros(At.shape[0]), np.zeros(Ct.shape[1])
    for k in range(r.shape[0]):
        for i in range(p):
            s = 0.0
            for j in range(i + 1):
                s += Li[i, j] * r[k, j]
            series[k, i] = s
        f[:] = 0.0
        new[:] = 0.0
        _add(Ct, x, f)
        _add(Dt, yu[k, p:], f)
        _add(At, x, new)
        _add(Bt, yu[k], new)
        series[k, p:] = f
        x[:] = new


@njit(cache=True, inline="always")
def _add(Mt, v, out):  # type: ignore[no-untyped-def]
    """Add ``M v`` to ``out``, column by column along memory, always in the same order."""
    for j in range(v.size):
        w = v[j]
        row = Mt[j]
        for i in range(out.size):
            out[i] += row[i] * w
