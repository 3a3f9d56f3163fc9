"""False-alarm rate of the largest of several CUSUMs running between bursts, from the joint law of the loop's noise and all psi.

One fault is made to set in at block s of a healthy loop: theta psi is added to the white residual from there on, until the
alarm at block T. With ``R_T = sum_{s <= T} sum_i LR_i(s..T)``, by Shiryaev's recursion over all onsets and faults, every
cycle from rest to alarm satisfies

    1 = sum_s sum_i E_{s,i}[1{T >= s} / R_T]

(importance sampling for rare change alarms: T. L. Lai and J. Z. Shan, *IEEE Trans. Autom. Control* 44, 1999). Once the CUSUMs
have forgotten that they began at rest, the terms are ``w_i P(T >= s)``, and the sum over s of ``P(T >= s)`` is the run length.
So onsets before that give the transient and later ones w_i; the relative error does not grow as alarms become rare. Where alarms are
promised more often than the CUSUMs forget, healthy loops are simulated and their alarms counted. No share of
a CUSUM in the union and no allowance for uneven steps is needed. One set of paths, from a fixed seed, serves all boundaries.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from afdsvc.detect.thresholds.regressor_information import NoiseDriven
from afdsvc.lti.reduce import balanced_truncation
from afdsvc.lti.statespace import Array, StateSpace

LARGEST = 8  # faults simulated together
WORK = 1.2e9  # multiplications spent: about half a second
FEWEST = 60  # fewest simulated paths per fault for which a rate is given
MOST = 10_000
DRAW = 20  # multiplications that a normal number costs, or an exponential
MEMORY = 16.0  # times 1 / mu^2: after so many blocks a CUSUM has forgotten where it began (it relaxes in 8 of them)
PATIENCE = 10.0  # times the mean time a fault takes to the boundary: nothing of weight alarms later
OFTEN = 1.0  # alarms promised while the CUSUMs forget, beyond which alarms are counted
SEEN = 3  # run lengths over which they are counted, after one that is not
SMALL = 1e-7  # singular values of the loop left out


@dataclass(frozen=True, slots=True, eq=False)
class JointRate:
    """CUSUMs of the faults ``which``, indices into those of the detector: waves ``C x (K p,)`` of the loop
    ``x+ = A x + B e``, in steps of ``block`` samples.
    """

    which: NDArray[np.intp]
    A: Array
    B: Array
    C: Array
    block: int

    def per_look(self, boundaries: Array, promised: float = 0.0) -> Array | None:
        """Return alarms per block at every (ascending) boundary where about ``promised`` are looked for; None where too few paths are affordable."""
        A, B, C, b = (np.ascontiguousarray(x, dtype=np.float64) for x in (self.A, self.B, self.C, boundaries))
        return _rates(A, B, C, b, self.block, promised)


def joint_rate(noise: NoiseDriven, which: NDArray[np.intp], theta: Array, block: int) -> JointRate | None:
    """Return what simulates the CUSUMs of the faults ``which`` at severities ``theta``, the most informative `LARGEST` of them
    when there are more; None for a loop in which psi answers the residual at once.
    """
    p = noise.loop.outputs // noise.count
    order = np.argsort(-(theta**2) * noise.passive[which], kind="stable")[:LARGEST]
    rows = np.concatenate([np.arange(p) + p * i for i in which[order]])
    loop = noise.loop
    if loop.D[rows, :p].any():
        return None
    waves = np.repeat(theta[order], p)[:, None] * loop.C[rows]
    small = balanced_truncation(StateSpace(loop.A, loop.B[:, :p], waves, np.zeros((len(rows), p)), loop.dt), tolerance=SMALL).system
    return JointRate(order, small.A, small.B, small.C, block)


@dataclass(frozen=True, slots=True)
class _Plan:
    """Of one fault: blocks until it no longer matters that the CUSUMs began at rest, patience after the onset, paths."""

    forgotten: int
    patience: int
    paths: int


def _rates(A: Array, B: Array, C: Array, b: Array, block: int, promised: float) -> Array | None:
    n, p = B.shape
    plans = _plans(A, B, C, p, block, float(b.max()))
    rng = np.random.Generator(np.random.PCG64(1))
    root = np.linalg.cholesky(solve_discrete_lyapunov(A, B @ B.T) + 1e-14 * np.eye(n))
    At, Bt, Ct = (np.ascontiguousarray(M.T) for M in (A, B, C))  # the loops run along memory
    if max(plan.forgotten for plan in plans) * promised > OFTEN:
        blocks = math.ceil(1 / promised)
        paths = int(min(WORK / (_work(A, B, C, block) * block + 4 * len(b) * len(plans)) / blocks / (1 + SEEN), MOST))
        x = rng.standard_normal((paths, n)) @ root.T
        return _counted(At, Bt, Ct, x, blocks, SEEN * blocks, block, rng, b) / (paths * SEEN * blocks) if paths >= FEWEST else None
    if min(plan.paths for plan in plans) < FEWEST:
        return None
    sums = np.zeros((3, len(b)))
    for i, plan in enumerate(plans):
        onset = ((np.arange(plan.paths) + 0.5) * (2 * plan.forgotten / plan.paths)).astype(np.int64)
        x = rng.standard_normal((plan.paths, n)) @ root.T
        at, weight = _paths(At, Bt, Ct, x, i, onset, plan.patience, block, rng, b)
        sums += _terms(at, weight, onset, plan.forgotten)
    early, steady, lost = sums
    return np.asarray(steady / (1 - early + lost))


def _plans(A: Array, B: Array, C: Array, p: int, block: int, boundary: float) -> Sequence[_Plan]:
    K, work, plans = len(C) // p, _work(A, B, C, block), []
    for i in range(K):
        own = C[p * i : p * (i + 1)]
        healthy, tilted = _information(A, B, own) * block, _information(A + B @ own, B, own) * block
        tilted = tilted if tilted > 0 else healthy
        forgotten, rise = int(np.ceil(MEMORY / healthy)), 2 * (boundary + 1) / tilted
        paths = min(WORK / K / work / block / (forgotten + rise), MOST)
        plans.append(_Plan(forgotten, int(np.ceil(PATIENCE * rise)), int(paths)))
    return plans


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
    """Return of one fault the terms of the transient, w, and w times the mean blocks passed in the transient: ``(3, B)``."""
    alive = (at < 0) | (at >= onset[:, None])
    first = onset < forgotten
    early, steady = forgotten * weight[first].mean(axis=0), weight[~first].sum(axis=0) / np.maximum(alive[~first].sum(axis=0), 1)
    return np.stack([early, steady, steady * forgotten * alive[first].mean(axis=0)])


@njit(cache=True, fastmath=True)
def _paths(At, Bt, Ct, start, who, onset, patience, block, rng, boundaries):  # type: ignore[no-untyped-def]
    """Return first crossings ``(N, B)`` in blocks (-1: none) and ``1 / R`` there, 0 for those before the onset."""
    N, n = start.shape
    p, many = Bt.shape[0], boundaries.size
    K = Ct.shape[1] // p
    at, weight = np.full((N, many), -1), np.zeros((N, many))
    x, new, waves, e = np.zeros(n), np.zeros(n), np.zeros(K * p), np.zeros(p)
    g, shiryaev, gained = np.zeros(K), np.zeros(K), np.zeros(K)
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
                g[i] = max(g[i] + gained[i], 0.0)
                shiryaev[i] = (1.0 + shiryaev[i]) * np.exp(min(gained[i], 300.0))
            highest, total = g.max(), shiryaev.sum()
            while crossed < many and highest > boundaries[crossed]:
                at[path, crossed] = t
                if t >= onset[path]:
                    weight[path, crossed] = 1.0 / total
                crossed += 1
            if crossed == many:
                break
    return at, weight


@njit(cache=True, fastmath=True)
def _counted(At, Bt, Ct, start, before, counted, block, rng, boundaries):  # type: ignore[no-untyped-def]
    """Return the alarms at every boundary in all paths, each CUSUM set to 0 by its alarms; the first ``before`` blocks do not count."""
    N, n = start.shape
    p, many = Bt.shape[0], boundaries.size
    K = Ct.shape[1] // p
    x, new, waves, e = np.zeros(n), np.zeros(n), np.zeros(K * p), np.zeros(p)
    g, gained, alarms = np.zeros((many, K)), np.zeros(K), np.zeros(many)
    for path in range(N):
        x[:] = start[path]
        g[:] = 0.0
        for t in range(before + counted):
            gained[:] = 0.0
            for _ in range(block):
                _advance(At, Bt, Ct, x, new, waves, e, -1, rng)
                _gain(waves, e, gained)
            for j in range(many):
                highest = 0.0
                for i in range(K):
                    g[j, i] = max(g[j, i] + gained[i], 0.0)
                    highest = max(highest, g[j, i])
                if highest > boundaries[j]:
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
    """Add the log likelihood ratios of one sample."""
    p = e.size
    for i in range(gained.size):
        for q in range(p):
            w = waves[i * p + q]
            gained[i] += w * (e[q] - 0.5 * w)
