"""Alarm rates of the two CUSUMs: many healthy runs stepped by a compiled loop of their own, waves that set in at a random time.

Runs are pushed from a random sample on, by the wave of a fault drawn at random, and weighted at the alarm by the mean likelihood
ratio over all the onsets and faults there might have been; the sum over onsets is Shiryaev's recursion. One set of runs serves
every boundary, each with the weight at its own alarm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from rates_cases import DESIGNS, RATES, RateCase
from rates_counting import SURE, Rate, kish, weighted
from rates_loop import advance, drive, gain, read, reflect

from afdsvc.detect.features.demodulation import window
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.statistics.active_cusum import _blocks
from afdsvc.detect.statistics.passive_cusum import PassiveDetector
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.lti.statespace import Array
from afdsvc.testing.machines import with_rate

GROUPS = 50  # of runs, for the jackknife
HOUR = 3600.0
LEAD = 3.0  # times the mean time the slowest CUSUM takes to its boundary: after that alarms come at a steady rate


@dataclass(frozen=True)
class Blocks:
    """The CUSUM of a burst at one promised rate: waves ``(blocks, H, D)`` in standard deviations, boundary; the samples of a block
    and the roots ``(blocks, 2 L, 2 L)`` of its sums of squares."""

    waves: Array
    boundary: float
    block: int
    roots: Array

    def coordinates(self, case: RateCase, e: Array) -> Array:
        """Return the standardised coordinates ``(blocks, D)`` of a burst's normalised residual."""
        (first, _), omega = window(case.burst), np.array(sorted(line.omega for line in case.burst.lines))
        count = len(self.roots)
        t = np.arange(first, first + count * self.block) * case.dt
        sines = np.stack([f(w * t) for w in omega for f in (np.sin, np.cos)], axis=1).reshape(count, self.block, -1)
        products = np.swapaxes(sines, 1, 2) @ e[first : first + count * self.block].reshape(count, self.block, -1)
        return np.asarray(np.linalg.pinv(np.swapaxes(self.roots, 1, 2)) @ products).reshape(count, -1)

    def first_crossing(self, z: Array) -> int:
        """Return the block in which the boundary is first crossed, -1 when it is not."""
        return int(_active(z.copy(), self.waves, 0, len(z), np.array([self.boundary]))[0][0])


def cusum_blocks(case: RateCase, rate: float) -> Blocks:
    """Return the CUSUM of a case's burst."""
    plan = case.statistic("cusum", rate).plan(case.burst, case.dt)  # type: ignore[attr-defined]
    ordered = tuple(sorted(case.burst.lines, key=lambda line: line.omega))
    block, roots = _blocks(case.burst, ordered, case.dt)
    return Blocks(np.ascontiguousarray(plan.waves), plan.boundary, block, roots)


def cusum_rates(case: RateCase, seed: int, runs: int) -> dict[float, Rate]:
    """Return the alarm rates per burst of the CUSUM during bursts."""
    return {
        rate: _cusum_rate(cusum_blocks(case, rate), np.random.default_rng([seed, 2, j]), runs) for j, rate in enumerate(RATES)
    }


def _cusum_rate(found: Blocks, rng: np.random.Generator, runs: int) -> Rate:
    n, H, D = found.waves.shape
    boundary, weights = np.array([found.boundary]), np.zeros(runs)
    for i in range(runs):
        weights[i] = _active(rng.normal(size=(n, D)), found.waves, int(rng.integers(H)), int(rng.integers(n)), boundary)[1][0]
    return weighted(weights)


def cusum_alarms(case: RateCase, residuals: Array, rate: float) -> Array:
    """Return whether these normalised residuals ``(N, n, p)`` of bursts alarm."""
    found = cusum_blocks(case, rate)
    return np.array([found.first_crossing(found.coordinates(case, e)) >= 0 for e in residuals])


@njit(cache=True, fastmath=True)
def _active(e, waves, who, onset, boundaries):  # type: ignore[no-untyped-def]
    """Return first crossings ``(B,)`` and weights there; the wave ``who`` is added to e from block ``onset`` on."""
    n, K, _ = waves.shape
    g, shiryaev, gained = np.zeros(K), np.zeros(K), np.zeros(K)
    at, weight = np.full(boundaries.size, -1), np.zeros(boundaries.size)
    for t in range(n):
        if t >= onset:
            e[t] += waves[t, who]
        gain(waves[t], e[t], gained, shiryaev)
        reflect(g, gained)
        _note(t, n, g.max(), shiryaev.sum() / K, boundaries, at, weight)
    return at, weight


@njit(cache=True, inline="always")
def _note(t, n, highest, shiryaev, boundaries, at, weight):  # type: ignore[no-untyped-def]
    """Keep time and weight of boundaries crossed for the first time."""
    for b in range(boundaries.size):
        if at[b] < 0 and highest > boundaries[b]:
            at[b] = t
            weight[b] = n / (shiryaev + n - 1 - t)


@dataclass(frozen=True)
class Watch:
    """The CUSUM between bursts on one machine: the healthy loop from normalised residual to psi, severities, boundaries."""

    A: Array
    B: Array
    C: Array
    theta: Array
    boundaries: Array
    settle: int
    block: int
    lead: int
    span: int

    @property
    def total(self) -> int:
        """Samples watched by every run."""
        return self.lead + self.span


def watch(case: RateCase, rates: tuple[float, ...] = RATES) -> Watch:
    """Return what `passive_rates` steps: promised are ``rate`` alarms in as many samples as the case's burst has."""
    found, filters = [_passive(case, rate) for rate in rates], regressors(case.problem)
    noise, p, which = noise_driven(case.problem), case.problem.plant.outputs, found[0].which
    rows, theta = np.concatenate([np.arange(p) + p * i for i in which]), found[0].test.severity
    assert not noise.loop.D[:, :p].any()  # the regressors lag the residual
    A, B, C = (np.ascontiguousarray(x) for x in (noise.loop.A, noise.loop.B[:, :p], noise.loop.C[rows]))
    boundaries, gain = np.array([f.boundary for f in found]), 0.5 * theta**2 * noise.passive[which]
    lead = max(int(np.ceil(LEAD * boundaries.max() / gain.min())), case.burst.samples)
    return Watch(A, B, C, theta, boundaries, filters.settling(), found[0].test.block, lead, case.burst.samples)


def _passive(case: RateCase, rate: float) -> PassiveDetector:
    per_hour = rate / (case.burst.samples * case.dt) * HOUR
    return DESIGNS["passive_cusum"].design(with_rate(case.problem, per_hour=per_hour), {})  # type: ignore[return-value]


def passive_rates(case: RateCase, seed: int, runs: int) -> dict[float, Rate]:
    """Return alarms per span of `watch`: span over the average run length from a CUSUM at rest.

    The run length is the area under the survival function over lead and span, plus what is left divided by the hazard of the
    span.
    """
    w = watch(case)
    total, p = w.total, w.B.shape[1]
    rng = np.random.default_rng([seed, 3])
    at, weights = np.zeros((runs, len(RATES)), dtype=np.int64), np.zeros((runs, len(RATES)))
    for i in range(runs):
        e, who, onset = rng.normal(size=(w.settle + total, p)), int(rng.integers(len(w.theta))), int(rng.integers(total))
        at[i], weights[i] = passive_alarms(w, e, who, onset)
    return {rate: _run_length_rate(at[:, j], weights[:, j], w) for j, rate in enumerate(RATES)}


def passive_alarms(w: Watch, e: Array, who: int = 0, onset: int | None = None) -> tuple[NDArray[np.int64], Array]:
    """Return first crossings of every boundary, counted from the end of settling (-1: none), and the weights there."""
    total = len(e) - w.settle
    return _watched(w.A, w.B, w.C, e, w.theta, w.settle, w.block, who, total if onset is None else onset, w.boundaries)


def _run_length_rate(at: NDArray[np.int64], weight: Array, w: Watch) -> Rate:
    """Return span over run length from crossings within lead and span; the error by the jackknife over groups of runs."""
    t = np.where(at >= 0, at + 1, w.total)
    lost, early, late = weight * (w.total - t), weight * (t <= w.lead), weight * ((at >= 0) & (t > w.lead))
    parts = np.array([[group.mean() for group in np.array_split(x, GROUPS)] for x in (lost, early, late)])

    def found(means: Array) -> float:
        area, alive = w.total - means[0], 1 - means[1] - means[2]
        hazard = -np.log(alive / (1 - means[1])) / w.span
        return float(w.span / (area + alive / hazard)) if hazard > 0 else 0.0

    value = found(parts.mean(axis=1))
    left_out = np.array([found(np.delete(parts, i, axis=1).mean(axis=1)) for i in range(GROUPS)])
    error = float(np.sqrt((GROUPS - 1) * left_out.var()))
    return Rate(value, value - SURE * error, value + SURE * error, len(at), kish(weight), weighted=True)


@njit(cache=True, fastmath=True)
def _watched(A, B, C, e, theta, settle, block, who, onset, boundaries):  # type: ignore[no-untyped-def]
    """Step the loop; after ``settle`` samples the CUSUMs run block by block, from ``onset`` later on psi of ``who`` is added to e."""
    n, p, K = A.shape[0], e.shape[1], theta.size
    x, new, psi = np.zeros(n), np.zeros(n), np.zeros((K, p))
    g, shiryaev, gained = np.zeros(K), np.zeros(K), np.zeros(K)
    at, weight = np.full(boundaries.size, -1), np.zeros(boundaries.size)
    for t in range(e.shape[0]):
        k = t - settle
        if k >= 0:
            read(C, x, psi)
            for i in range(K):
                psi[i] *= theta[i]
            if k >= onset:
                e[t] += psi[who]
            gain(psi, e[t], gained, shiryaev)
            if k % block == block - 1:
                reflect(g, gained)
                _note(k, e.shape[0] - settle, g.max(), shiryaev.sum() / K, boundaries, at, weight)
        advance(A, x, new)
        drive(B, e[t], new)
        x[:] = new
    return at, weight
