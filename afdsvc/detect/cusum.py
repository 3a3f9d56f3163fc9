"""CUSUM on log-likelihood ratios: during a burst against the waves it would cause, and always against the loop's own
noise.

    g_i <- max(0, g_i + theta_i s_i' e - |theta_i s_i|^2 / 2),   alarm when max_i g_i > b

For one fault the test is exactly minimax: no other reacts sooner, in the worst case, at the same average run length
(G. V. Moustakides, *Ann. Statist.* 14, 1986). The boundary comes from the run length (`arl`), not from a rule of
thumb. Several faults whose waves resemble each other alarm together: each counts with its share of the union of
alarms, so that the promised rate is kept and not divided by the number of faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import brentq

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect import arl, maximum
from afdsvc.detect.demodulate import Basis, BasisSums, project
from afdsvc.detect.hypotheses import linear_fit, weights
from afdsvc.detect.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.once import Played
from afdsvc.detect.reach import reachable
from afdsvc.detect.templates import templates
from afdsvc.detect.uncertainty import models
from afdsvc.detect.watch import BurstSamples, Finding
from afdsvc.lti.statespace import Array

HERMITE = 15  # models averaged over in one direction
UNSEEN = 1e-3  # deflection of a wave over the whole burst below which the fault is left out


@dataclass(frozen=True, slots=True, eq=False)
class CusumState:
    """``g (K,)``; since each g last was zero: score and information of all faults, ``b, G (K, K)``, and samples ``n
    (K,)``.
    """

    g: Array
    b: Array
    G: Array
    n: Array

    @classmethod
    def start(cls, faults: int) -> CusumState:
        """Return the state at rest."""
        return cls(np.zeros(faults), np.zeros((faults, faults)), np.zeros((faults, faults)), np.zeros(faults))

    def step(
        self, e: Array, waves: Array, psi: Array, theta: Array, boundary: float, peak: float
    ) -> tuple[CusumState, int, int, float]:
        """Return the state, the sample at which the boundary was crossed (-1 if not), by which fault, and the peak so
        far.

        ``e (n, p)`` is the normalised residual, ``waves (n, K, p)`` what severity 1 would add in the log-likelihood
        ratios and ``theta (K,)`` their severities; ``psi (n, K, p)`` are the regressors severities are estimated
        with. Stops at the crossing.
        """
        g, b, G, n = self.g.copy(), self.b.copy(), self.G.copy(), self.n.copy()
        e, waves, psi = np.ascontiguousarray(e), np.ascontiguousarray(waves), np.ascontiguousarray(psi)
        at, who, peak = _cusum(e, waves, psi, theta, boundary, peak, g, b, G, n)
        return CusumState(g, b, G, n), at, who, peak


@dataclass(frozen=True, slots=True, eq=False)
class ActiveSums:
    """The waves expected, the faults this burst can see, boundary, CUSUMs and largest g so far."""

    waves: Array
    seen: NDArray[np.intp]
    theta: Array
    boundary: float
    state: CusumState
    peak: float
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ActiveCusum:
    """CUSUM over a burst on deterministic waves; severities are chosen so that every wave's deflection over the burst
    is ``deflection``, or smaller where the fault cannot cause that much: tuned to the small fault, early on a large
    one.
    """

    problem: DetectionProblem
    deflection: float = 12.0
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> ActiveSums:
        """Return the state before the first sample."""
        return _prepared(self, Played.of(burst), dt)

    def prepare(self, burst: Burst, dt: float) -> ActiveSums:
        """Return waves and boundary for a burst, computed anew."""
        problem = self.problem
        asked, reach = burst.play(dt), reachable(problem)
        low = 0.999 * np.array([reach[name][0] for name in problem.fault_names])
        theta = 0.05 * low
        found = templates(problem, asked, theta)
        for _ in range(4):  # the deflection is not quite proportional to the severity
            theta = np.maximum(low, theta * self.deflection / np.maximum(np.sqrt(np.diag(found.gram)), 1e-12))
            found = templates(problem, asked, theta)
        seen = np.flatnonzero(np.sqrt(np.diag(found.gram)) > UNSEEN)
        waves = found.waves[:, seen] / theta[seen, None]
        gram = found.gram[np.ix_(seen, seen)]
        boundary = _burst_boundary(problem, burst, gram, found.waves[:, seen]) if len(seen) else math.inf
        return ActiveSums(waves, seen, theta[seen], boundary, CusumState.start(len(seen)), 0.0)

    def step(self, sums: ActiveSums, samples: BurstSamples) -> tuple[ActiveSums, Finding | None]:
        """Return the state after the samples and a finding at the first crossing."""
        n, K = len(samples.series), samples.series.shape[1]
        both = np.concatenate([samples.series, sums.waves[samples.first : samples.first + n]], axis=1)
        cleaning, both, _ = self.nuisances.clean(sums.cleaning, samples.block, both)
        e, psi, waves = both[:, 0], both[:, 1 + sums.seen], both[:, K:]
        state, at, who, peak = sums.state.step(e, waves, psi, sums.theta, sums.boundary, sums.peak)
        sums = replace(sums, state=state, peak=peak, cleaning=cleaning)
        return sums, None if at < 0 else self._finding(sums, who, samples.first + at)

    def decide(self, sums: ActiveSums, burst: Burst, dt: float) -> Sequence[Finding]:
        """Return the finding at the end of a burst that did not cross the boundary."""
        who = int(np.argmax(sums.state.g)) if len(sums.seen) else 0
        return [self._finding(sums, who, burst.samples - 1)]

    def _finding(self, sums: ActiveSums, who: int, sample: int) -> Finding:
        names = [self.problem.fault_names[i] for i in sums.seen]
        return segment_finding(sums.state, who, names, sums.peak, sums.boundary, self.problem.severity_range, sample)


@lru_cache(maxsize=256)  # the same burst is played again and again, on many machines; every one is a megabyte or so
def _prepared(statistic: ActiveCusum, played: Played, dt: float) -> ActiveSums:
    return statistic.prepare(played.burst, dt)


def segment_finding(
    state: CusumState,
    who: int,
    names: Sequence[str],
    peak: float,
    boundary: float,
    bounds: tuple[float, float],
    sample: int,
) -> Finding:
    """Return a finding whose fits use the samples since the CUSUM of fault ``who`` last was zero.

    Such a stretch begins and ends where the data look faulty, so its severities are bounds, not estimates.
    """
    if not names:
        return Finding(0.0, math.inf)
    fits = tuple(linear_fit(n, float(state.b[who, i]), float(state.G[who, i]), bounds) for i, n in enumerate(names))
    parts = {"sample": float(sample), "delay_samples": float(state.n[who])}
    return Finding(peak, boundary, fits, weights(fits), parts, early=True)


def _burst_steps(problem: DetectionProblem, burst: Burst, gram: Array, waves: Array, share: Array) -> list[Step]:
    """Return how the CUSUMs walk under every model the uncertainty allows, weighted by share and model."""
    mu = np.sqrt(np.diag(gram) / burst.samples)
    if not problem.uncertainty:
        return _grouped(mu, share)
    ordered = sorted(burst.lines, key=lambda line: line.omega)
    basis = Basis(tuple(line.omega for line in ordered))
    steps = []
    for k in range(len(mu)):
        sums = BasisSums.empty(basis, waves.shape[2]).add(basis, 0, problem.plant.dt, waves[:, k])
        lines = project(sums, basis)
        found = models(problem, ordered, lines.R)
        mean, sd = found.along(lines.z.ravel() / np.linalg.norm(lines.z))
        for q, weight in enumerate(found.weights):
            s = float(mu[k] * sd[q])
            # the wave's part along the lines moves every increment; more noise widens it
            bias = float(mean[q] * np.linalg.norm(lines.z) / burst.samples) + (s**2 - float(mu[k]) ** 2) / 2
            steps.append(Step(s, bias, float(share[k] * weight)))
    return steps


def _burst_boundary(problem: DetectionProblem, burst: Burst, gram: Array, waves: Array) -> float:
    """Return the boundary for K CUSUMs over one burst, by the shares they have in the union of alarms."""
    rate, samples = problem.false_alarms.per_burst, burst.samples
    share = maximum.shares(_unit_vectors(gram), _level(rate / len(gram)))
    steps = _burst_steps(problem, burst, gram, waves, share)

    def excess(b: float) -> float:
        return math.log(sum(s.weight * arl.alarm_probability(s.mu, b, samples, bias=s.bias) for s in steps) / rate)

    return max(_crossing(excess, math.log(samples * len(gram) / rate), 1e-3) - _uneven(waves), 0.05)


def _uneven(waves: Array) -> float:
    """Return by how much uneven steps overshoot a boundary more than equal ones of the same mean square.

    A boundary is crossed where information comes in, so the mean step at a crossing is ``sum |s|^3 / sum |s|^2``.
    """
    size = np.linalg.norm(waves, axis=2)
    square = np.sum(size**2, axis=0)
    return float(arl.OVERSHOOT * np.mean(np.sum(size**3, axis=0) / square - np.sqrt(square / len(waves))))


def rate_boundary(correlation: Array, mu: Array, bias: Array, per_sample: float) -> float:
    """Return the boundary at which K CUSUMs that run always alarm ``per_sample`` times per sample in all.

    ``mu (K,)`` is the deflection per sample of each, ``correlation (K, K)`` that of their log-likelihood ratios,
    ``bias (K,)`` the standard deviation of their mean increments over uncertain models.
    """
    share = maximum.shares(_unit_vectors(correlation), _level(per_sample))
    steps = _grouped(mu, share) if not bias.any() else _biased(mu, bias, share)

    def excess(b: float) -> float:
        return math.log(sum(s.weight / arl.run_length(s.mu, b, bias=s.bias) for s in steps) / per_sample)

    return _crossing(excess, math.log(len(mu) / per_sample) + 1, 1e-4)


@dataclass(frozen=True, slots=True)
class Step:
    """Increments of one CUSUM under one model: deflection per sample, bias of the mean, weight in the sum of rates."""

    mu: float
    bias: float
    weight: float


def _grouped(mu: Array, share: Array) -> list[Step]:
    """Return the distinct deflections per sample, to a per cent, and the shares that go with each."""
    steps, which = np.unique(np.round(np.log(mu), 2), return_inverse=True)
    weight = np.bincount(which.ravel(), weights=share)
    return [Step(float(np.exp(s)), 0.0, float(w)) for s, w in zip(steps, weight, strict=True)]


def _biased(mu: Array, bias: Array, share: Array) -> list[Step]:
    """Return steps whose bias is normal, by Gauss-Hermite quadrature."""
    z, w = np.polynomial.hermite_e.hermegauss(HERMITE)
    nodes = list(zip(z, w / w.sum(), strict=True))
    triples = zip(mu, bias, share, strict=True)
    return [Step(float(m), float(d * zq), float(s * wq)) for m, d, s in triples for zq, wq in nodes]


def _crossing(excess: Callable[[float], float], high: float, xtol: float) -> float:
    """Return the boundary at which the logarithm of found over wanted rate falls through zero."""
    low = 0.05
    if excess(low) <= 0:
        return low
    while excess(high) > 0:  # biased increments may need a higher boundary than any unbiased ones
        high *= 1.5
    return float(brentq(excess, low, high, xtol=xtol))


def _level(probability: float) -> float:
    """Return the deflection at which a CUSUM crosses a boundary of about ``ln(1 / probability)``."""
    return math.sqrt(2 * math.log(1 / probability))


def _unit_vectors(gram: Array) -> Array:
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@njit(cache=True)
def _cusum(e, waves, psi, theta, boundary, peak, g, b, G, n):  # type: ignore[no-untyped-def]
    K, p = theta.size, e.shape[1]
    score, information = np.zeros(K), np.zeros(K)
    for t in range(e.shape[0]):
        _score(psi[t], e[t], score, information)
        highest = 0
        for i in range(K):
            step = 0.0
            for q in range(p):
                wave = theta[i] * waves[t, i, q]
                step += wave * e[t, q] - 0.5 * wave * wave
            g[i] += step
            _segment(g, b, G, n, i, score, information)
            if g[i] > g[highest]:
                highest = i
        peak = max(peak, g[highest])
        if g[highest] > boundary:
            return t, highest, peak
    return -1, -1, peak


@njit(cache=True)
def _score(psi, e, score, information):  # type: ignore[no-untyped-def]
    for i in range(score.size):
        s = v = 0.0
        for q in range(e.size):
            s += psi[i, q] * e[q]
            v += psi[i, q] * psi[i, q]
        score[i], information[i] = s, v


@njit(cache=True)
def _segment(g, b, G, n, i, score, information):  # type: ignore[no-untyped-def]
    """Begin a new segment when g_i is down to zero, otherwise add to the one that runs."""
    if g[i] <= 0.0:
        g[i], n[i] = 0.0, 0.0
        b[i, :] = 0.0
        G[i, :] = 0.0
    else:
        n[i] += 1
        for j in range(score.size):
            b[i, j] += score[j]
            G[i, j] += information[j]
