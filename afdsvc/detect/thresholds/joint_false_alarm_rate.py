"""False-alarm rate of the largest of several CUSUMs running between bursts, from the joint law of the loop's noise and all psi.

One fault is made to set in at block s of a healthy loop: theta psi is added to the white residual from there on, until the
alarm at block T. With ``R_T = sum_{s <= T} sum_i LR_i(s..T)``, by Shiryaev's recursion over all onsets and faults, every
cycle from rest to alarm satisfies

    1 = sum_s sum_i E_{s,i}[1{T >= s} / R_T]

(importance sampling for rare change alarms: T. L. Lai and J. Z. Shan, *IEEE Trans. Autom. Control* 44, 1999). Once the CUSUMs
have forgotten that they began at rest, the terms are ``w_i P(T >= s)``, and the sum over s of ``P(T >= s)`` is the run length.
So onsets before that give the transient and one after it w_i; the relative error does not grow as alarms become rare. Where alarms are
promised more often than the CUSUMs forget, healthy loops are simulated and their alarms counted. No share of
a CUSUM in the union and no allowance for uneven steps is needed, and boundaries move with the information gained as in the
detector. One set of paths, from a fixed seed, serves all boundaries.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from afdsvc.detect.thresholds.deflection_boundary import DeflectionBoundary, boundary_at
from afdsvc.detect.thresholds.regressor_information import NoiseDriven
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.statespace import Array, StateSpace

LARGEST = 8  # faults simulated together
LEAST = 0.01  # information, as a share of the largest, of faults that are simulated: alarms come in proportion to it
WORK = 6e9  # multiplications spent at most on one set of boundaries: about five seconds
PATHS = 600  # simulated at most
FEWEST = 20  # of a fault
EARLY = 5  # of so many, one begins before the CUSUMs have forgotten
INEXACT = 0.1  # relative standard error, at the boundary in the middle, above which no rates are given
DRAW = 50  # multiplications that a normal number costs, or an exponential
LOOK = 12  # and one CUSUM with its boundary
MEMORY = 64.0  # times 1 / mu^2: after so many blocks R has forgotten where it began (a CUSUM relaxes in 8 of them, the tail of R in their number)
PATIENCE = 10.0  # times the mean time a fault takes to the boundary: nothing of weight alarms later
OFTEN = 0.5  # alarms promised while the CUSUMs forget, beyond which alarms are counted
ALARMS = 450  # counted at most
SEEN = 3  # run lengths over which they are counted, after one that is not
SMALL = 1e-7  # singular values of the loop left out


@dataclass(frozen=True, slots=True, eq=False)
class JointRate:
    """CUSUMs of the faults ``which``, indices into those of the detector: waves ``C x (K p,)`` of the loop
    ``x+ = A x + B e``, in steps of ``block`` samples; ``clock`` moves their boundaries.
    """

    which: NDArray[np.intp]
    A: Array
    B: Array
    C: Array
    block: int
    clock: DeflectionBoundary

    def per_look(self, boundaries: Array, promised: float = 0.0) -> Array | None:
        """Return alarms per block at every (ascending) boundary where about ``promised`` are looked for; None where too few paths are affordable for a rate to a tenth."""
        A, B, C, b = (np.ascontiguousarray(x, dtype=np.float64) for x in (self.A, self.B, self.C, boundaries))
        return _rates(A, B, C, b, self.block, promised, self.clock.arrays)


def joint_rate(noise: NoiseDriven, which: NDArray[np.intp], theta: Array, block: int, clock: DeflectionBoundary | None = None) -> JointRate | None:
    """Return what simulates the CUSUMs of the faults ``which`` at severities ``theta``, at most the `LARGEST` most informative of them;
    None for a loop in which psi answers the residual at once. ``clock`` moves the boundaries of faster ones; without it they stay.
    """
    p, information = noise.loop.outputs // noise.count, theta**2 * noise.passive[which]
    order = np.argsort(-information, kind="stable")[: min(LARGEST, int(np.sum(information >= LEAST * information.max())))]
    rows = np.concatenate([np.arange(p) + p * i for i in which[order]])
    loop = noise.loop
    if loop.D[rows, :p].any():
        return None
    waves = np.repeat(theta[order], p)[:, None] * loop.C[rows]
    small = balanced_truncation(StateSpace(loop.A, loop.B[:, :p], waves, np.zeros((len(rows), p)), loop.dt), tolerance=SMALL).system
    sign = np.where(np.take_along_axis(small.B, np.abs(small.B).argmax(axis=1)[:, None], axis=1) < 0, -1.0, 1.0)  # paths are the same in any units
    kept = replace(clock, expected=clock.expected[order], falls=clock.falls[order]) if clock else DeflectionBoundary.flat(len(order))
    return JointRate(order, sign * small.A * sign.T, sign * small.B, small.C * sign.T, block, kept)


@dataclass(frozen=True, slots=True)
class _Plan:
    """Of one fault: blocks until it no longer matters that the CUSUMs began at rest, mean blocks from the onset to the alarm, paths."""

    forgotten: int
    rise: int
    paths: int

    @property
    def blocks(self) -> int:
        """Mean blocks of a path."""
        return self.forgotten + self.rise


def _rates(A: Array, B: Array, C: Array, b: Array, block: int, promised: float, clock: tuple[Array, ...]) -> Array | None:
    n, p = B.shape
    plans = _plans(A, B, C, p, block, float(b.max()))
    rng = np.random.Generator(np.random.PCG64(1))
    root = np.linalg.cholesky(solve_discrete_lyapunov(A, B @ B.T) + 1e-14 * np.eye(n))
    At, Bt, Ct = (np.ascontiguousarray(M.T) for M in (A, B, C))  # the loops run along memory
    if max(plan.forgotten for plan in plans) * promised > OFTEN:
        blocks = math.ceil(1 / promised)
        paths = int(min(WORK / (_work(A, B, C, block) * block + LOOK * len(b) * len(plans)) / blocks / (1 + SEEN), ALARMS / SEEN))
        if paths * SEEN < INEXACT**-2:
            return None
        x = rng.standard_normal((paths, n)) @ root.T
        counts: Array = _counted(At, Bt, Ct, x, blocks, SEEN * blocks, block, rng, b, *clock)
        return counts / (paths * SEEN * blocks)
    if sum(plan.paths * plan.blocks for plan in plans) * block * _work(A, B, C, block) > 2 * WORK:  # the fewest paths of slow faults
        return None
    sums = np.zeros((4, len(b)))
    for i, plan in enumerate(plans):
        early = plan.paths // EARLY
        onset = np.append(np.arange(0.5, early) * plan.forgotten // early, np.full(plan.paths - early, plan.forgotten)).astype(np.int64)
        x = rng.standard_normal((plan.paths, n)) @ root.T
        at, weight = _paths(At, Bt, Ct, x, i, onset, int(PATIENCE * plan.rise), block, rng, b, *clock)
        sums += _terms(at, weight, onset, plan.forgotten)
    transient, steady, lost, variance = sums
    middle = len(b) // 2
    return np.asarray(steady / (1 - transient + lost)) if variance[middle] <= (INEXACT * steady[middle]) ** 2 else None


def _plans(A: Array, B: Array, C: Array, p: int, block: int, boundary: float) -> Sequence[_Plan]:
    """Return the plans of all faults, paths in proportion to the information, as alarms are."""
    own = [C[i : i + p] for i in range(0, len(C), p)]
    healthy = np.array([_information(A, B, c) * block for c in own])
    tilted = np.array([_information(A + B @ c, B, c) * block for c in own])
    forgotten, rise = np.ceil(MEMORY / healthy), 2 * (boundary + 1) / np.where(tilted > 0, tilted, healthy)
    share = healthy / healthy.sum()
    affordable = WORK / _work(A, B, C, block) / block / float(share @ (forgotten + rise))
    each = zip(forgotten.tolist(), rise.tolist(), share.tolist(), strict=True)
    return [_Plan(int(f), math.ceil(r), max(int(min(affordable, PATHS) * s), FEWEST)) for f, r, s in each]


def _work(A: Array, B: Array, C: Array, block: int) -> float:
    """Return the multiplications that a sample takes."""
    n, p = B.shape
    return float(n * n + n * p + n * len(C) + DRAW * (p + len(C) // p / block))


def _information(A: Array, B: Array, C: Array) -> float:
    """Return the mean of ``|C x|^2``; 0 where the loop does not survive, and a fault is seen all the sooner."""
    if np.abs(np.linalg.eigvals(A)).max(initial=0.0) >= 1:
        return 0.0
    return float(np.trace(C @ solve_discrete_lyapunov(A, B @ B.T) @ C.T))


def _terms(at: NDArray[np.int64], weight: Array, onset: NDArray[np.int64], forgotten: int) -> Array:
    """Return of one fault the terms of the transient, w, w times the mean blocks passed in the transient, and the variance of w: ``(4, B)``."""
    alive = (at < 0) | (at >= onset[:, None])
    first = onset < forgotten
    late, living = weight[~first], np.maximum(alive[~first].sum(axis=0), 1)
    early, steady = forgotten * weight[first].mean(axis=0), late.sum(axis=0) / living
    return np.stack([early, steady, steady * forgotten * alive[first].mean(axis=0), len(late) * late.var(axis=0) / living**2])


@njit(cache=True, fastmath=True)
def _paths(At, Bt, Ct, start, who, onset, patience, block, rng, boundaries, deflection, table, expected, falls):  # type: ignore[no-untyped-def]
    """Return first crossings ``(N, B)`` in blocks (-1: none) and ``1 / R`` there, 0 for those before the onset."""
    N, n = start.shape
    p, many = Bt.shape[0], boundaries.size
    K = Ct.shape[1] // p
    at, weight = np.full((N, many), -1), np.zeros((N, many))
    x, new, waves, e = np.zeros(n), np.zeros(n), np.zeros(K * p), np.zeros(p)
    g, shiryaev, gained = np.zeros((K, 3)), np.zeros(K), np.zeros((K, 2))
    for path in range(N):
        x[:] = start[path]
        g[:] = 0.0
        shiryaev[:] = 0.0
        crossed = 0
        for t in range(onset[path] + patience):
            gained[:] = 0.0
            for _ in range(block):
                _advance(At, Bt, Ct, x, new, waves, e, who if t >= onset[path] else -1, rng)
                _gain(waves, e, gained)
            for i in range(K):
                shiryaev[i] = (1.0 + shiryaev[i]) * np.exp(min(gained[i, 0], 300.0))
            highest, total = _highest(g, gained, boundaries[crossed], deflection, table, expected, falls), shiryaev.sum()
            while crossed < many and highest > boundaries[crossed]:
                at[path, crossed] = t
                if t >= onset[path]:
                    weight[path, crossed] = 1.0 / total
                crossed += 1
            if crossed == many:
                break
    return at, weight


@njit(cache=True, fastmath=True)
def _counted(At, Bt, Ct, start, before, counted, block, rng, boundaries, deflection, table, expected, falls):  # type: ignore[no-untyped-def]
    """Return the alarms at every boundary in all paths, each CUSUM set to 0 by its alarms; the first ``before`` blocks do not count."""
    N, n = start.shape
    p, many = Bt.shape[0], boundaries.size
    K = Ct.shape[1] // p
    x, new, waves, e = np.zeros(n), np.zeros(n), np.zeros(K * p), np.zeros(p)
    g, gained, alarms = np.zeros((many, K, 3)), np.zeros((K, 2)), np.zeros(many)
    for path in range(N):
        x[:] = start[path]
        g[:] = 0.0
        for t in range(before + counted):
            gained[:] = 0.0
            for _ in range(block):
                _advance(At, Bt, Ct, x, new, waves, e, -1, rng)
                _gain(waves, e, gained)
            for j in range(many):
                if _highest(g[j], gained, boundaries[j], deflection, table, expected, falls) > boundaries[j]:
                    g[j] = 0.0
                    alarms[j] += t >= before
    return alarms


@njit(cache=True, fastmath=True, inline="always")
def _advance(At, Bt, Ct, x, new, waves, e, who, rng):  # type: ignore[no-untyped-def]
    """Read the waves, draw the residual (with the wave of ``who`` unless that is -1), advance x."""
    p = e.size
    waves[:] = 0.0
    for j in range(x.size):
        for i in range(waves.size):
            waves[i] += Ct[j, i] * x[j]
    for q in range(p):
        e[q] = rng.standard_normal()
        if who >= 0:
            e[q] += waves[who * p + q]
    new[:] = 0.0
    for j in range(x.size):
        for i in range(x.size):
            new[i] += At[j, i] * x[j]
    for q in range(p):
        for i in range(x.size):
            new[i] += Bt[q, i] * e[q]
    x[:] = new


@njit(cache=True, fastmath=True, inline="always")
def _gain(waves, e, gained):  # type: ignore[no-untyped-def]
    """Add the log likelihood ratios of one sample and the information it brings."""
    p = e.size
    for i in range(gained.shape[0]):
        for q in range(p):
            w = waves[i * p + q]
            gained[i, 0] += w * (e[q] - 0.5 * w)
            gained[i, 1] += w * w


@njit(cache=True, fastmath=True)
def _highest(g, gained, boundary, deflection, table, expected, falls):  # type: ignore[no-untyped-def]
    """Advance ``g (K, 3)``, each CUSUM with its information and blocks since it last was zero, by one block; return the largest,
    less what its boundary has moved by."""
    highest = 0.0
    for i in range(g.shape[0]):
        g[i, 0] += gained[i, 0]
        if g[i, 0] <= 0.0:
            g[i] = 0.0
            continue
        g[i, 1] += gained[i, 1]
        g[i, 2] += 1.0
        if g[i, 0] > max(boundary, highest) or g[i, 1] > falls[i] * g[i, 2]:
            highest = max(highest, g[i, 0] + boundary - boundary_at(boundary, deflection, table, expected[i], g[i, 1], g[i, 2]))
    return highest
