"""Alarm rates of the regressions on machines whose residual is linear in the severity: sums stepped by a compiled loop.

The healthy loop written in its own innovations drives every regressor psi. Rare alarms: ``theta psi`` of a fault drawn at random is
added to the innovations, which is what that fault does, and runs are weighted by ``exp(theta b - theta^2 G / 2)`` averaged over
faults and severities. The iterated regression sees the samples after its settling, the regression all of them.
Thresholds depend on every burst; they lie in a narrow band, and the exact one is only found where a statistic falls inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from rates_cases import RATES, RateCase
from rates_counting import Rate, counted, weighted
from rates_loop import advance, drive, read

from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.detect.thresholds.regressor_information import NoiseDriven, noise_driven
from afdsvc.lti.statespace import Array

REGRESSIONS = ("regression", "iterated_regression")
COUNTED = 0.1  # rates from here on are counted on healthy bursts, smaller ones weighted
AIMED = (1e-2, 5e-4, 1e-5)  # tails whose points the pushed deflections are
BAND = 12  # bursts from which the band of thresholds is taken


@dataclass(frozen=True)
class Loop:
    """The healthy loop from ``[normalised residual, alpha]`` to psi; alpha of quiet samples and burst ``(n, m)``; ``burst`` and
    ``settled`` are the samples at which the two regressions begin to count; ``roots``: mean and
    standard deviation of their signed roots without a fault."""

    A: Array
    Br: Array
    Ba: Array
    C: Array
    Da: Array
    alpha: Array
    burst: int
    settled: int
    faults: int
    outputs: int
    noise: NoiseDriven
    roots: tuple[tuple[Array, Array], tuple[Array, Array]]

    def sums(self, e: Array, who: int = 0, theta: float = 0.0) -> tuple[Array, Array, Array, Array]:
        """Return score ``(K,)`` and information ``(K, K)`` over the whole burst, then those after settling."""
        both = _sums(
            self.A, self.Br, self.Ba, self.C, self.Da, self.alpha, e, self.burst, self.settled, self.faults, who, theta
        )
        b, G = both
        return b[0], G[0], b[1], G[1]


def loop(case: RateCase) -> Loop:
    """Return the loop of a case."""
    f = regressors(case.problem)
    noise = noise_driven(case.problem)
    p, K, before = case.problem.plant.outputs, f.faults, f.settling(1e-3)
    system = noise.loop
    assert not system.D[:, :p].any()  # the regressors lag the residual
    alpha = np.vstack([np.zeros((before, case.burst.inputs)), case.burst.play(case.dt)])
    Br, Ba, Da = (np.ascontiguousarray(x) for x in (system.B[:, :p], system.B[:, p:], system.D[:, p:]))
    settle = case.statistic("iterated_regression", 0.1).settle  # type: ignore[attr-defined]
    A, C = np.ascontiguousarray(system.A), np.ascontiguousarray(system.C)
    roots = noise.signed_root(case.burst.samples, case.burst), noise.signed_root(case.burst.samples - settle, case.burst)
    return Loop(A, Br, Ba, C, Da, alpha, before, before + settle, K, p, noise, roots)


def statistics(on: Loop, sums: tuple[Array, Array, Array, Array]) -> dict[str, tuple[float, Array]]:
    """Return for every regression its statistic and the correlations its threshold follows from."""
    b, G, later_b, later_G = sums
    plain = _largest(-b / np.sqrt(np.diag(G)), on.roots[0])
    later = _largest(np.maximum(-later_b / np.sqrt(np.diag(later_G)), 0.0), on.roots[1])
    return {"regression": (plain, correlation(G)), "iterated_regression": (later, correlation(later_G))}


def _largest(root: Array, moments: tuple[Array, Array]) -> float:
    """Return the largest signed root, mean and standard deviation without a fault taken out."""
    mean, sd = (v[: len(root)] for v in moments)
    return float(np.max((root - mean) / sd))


def regression_rates(case: RateCase, seed: int, runs: int, healthy_runs: int) -> dict[str, dict[float, Rate]]:
    """Return the alarm rates per burst of both regressions."""
    on = loop(case)
    rng = np.random.default_rng([seed, 6])
    bands = {name: _band([statistics(on, on.sums(_noise(rng, on)))[name][1] for _ in range(BAND)]) for name in REGRESSIONS}
    hits = {name: np.zeros(len(RATES)) for name in REGRESSIONS}
    for _ in range(healthy_runs):
        found = statistics(on, on.sums(_noise(rng, on)))
        for name in REGRESSIONS:
            hits[name] += _alarms(*found[name], *bands[name], at_most=1)
    weights = {name: np.zeros((runs, len(RATES))) for name in REGRESSIONS}
    who, theta = pushes(case, on)
    for i in range(runs):
        j = int(rng.integers(len(who)))
        sums = on.sums(_noise(rng, on), int(who[j]), float(theta[j]))
        weight = 1 / np.mean(np.exp(theta * sums[0][who] - 0.5 * theta**2 * np.diag(sums[1])[who]))
        found = statistics(on, sums)
        for name in REGRESSIONS:
            weights[name][i] = weight * _alarms(*found[name], *bands[name])
    return {name: _rates(hits[name], healthy_runs, weights[name]) for name in REGRESSIONS}


def _rates(hits: Array, of: int, weights: Array) -> dict[float, Rate]:
    return {r: counted(int(hits[j]), of) if r >= COUNTED else weighted(weights[:, j]) for j, r in enumerate(RATES)}


def pushes(case: RateCase, on: Loop) -> tuple[Array, Array]:
    """Return the faults and severities runs are pushed with."""
    information = case.burst.samples * (on.noise.passive + on.noise.excited(case.burst)[0])[: on.faults]
    low = 0.9 * np.array([bounds[0] for bounds in reachable(case.problem).values()])
    theta = [np.maximum(-tail_point(q) / np.sqrt(information), low) for q in AIMED]
    return np.tile(np.arange(on.faults), len(AIMED)), np.concatenate(theta)


def _noise(rng: np.random.Generator, on: Loop) -> Array:
    return rng.normal(size=(len(on.alpha), on.outputs))


def correlation(G: Array) -> Array:
    """Return the correlations of scores with information G."""
    scale = np.sqrt(np.diag(G))
    return np.asarray(G / np.outer(scale, scale))


def threshold(correlation: Array, rate: float) -> float:
    """Return the threshold of the largest of normals so correlated."""
    values, vectors = np.linalg.eigh(correlation)
    return maximum.maximum_threshold(vectors * np.sqrt(np.maximum(values, 0.0)), rate)


def _band(correlations: list[Array]) -> tuple[Array, Array]:
    """Return the least and largest threshold of every rate, the band widened threefold."""
    h = np.array([[threshold(c, rate) for rate in RATES] for c in correlations])
    low, high = h.min(axis=0), h.max(axis=0)
    return low - (high - low) - 1e-9, high + (high - low) + 1e-9


def _alarms(statistic: float, correlation: Array, low: Array, high: Array, at_most: int = len(RATES)) -> Array:
    """Return whether the statistic alarms at every rate, looked at closely for the first ``at_most`` rates only."""
    out = statistic > high
    for j in np.flatnonzero((statistic > low) & ~out)[:at_most]:
        out[j] = statistic > threshold(correlation, RATES[j])
    return np.asarray(out)


@njit(cache=True, fastmath=True)
def _sums(A, Br, Ba, C, Da, alpha, e, burst, settled, K, who, theta):  # type: ignore[no-untyped-def]
    n, p = A.shape[0], e.shape[1]
    x, new, psi = np.zeros(n), np.zeros(n), np.zeros((K, p))
    b, G = np.zeros((2, K)), np.zeros((2, K, K))
    for t in range(e.shape[0]):
        if t >= burst:
            read(C, x, psi)
            drive(Da, alpha[t], psi.reshape(K * p))
            e[t] += theta * psi[who]
            _add(psi, e[t], b[0], G[0])
            if t == settled - 1:
                b[1], G[1] = b[0], G[0]
        advance(A, x, new)
        drive(Br, e[t], new)
        drive(Ba, alpha[t], new)
        x[:] = new
    b[1], G[1] = b[0] - b[1], G[0] - G[1]
    return b, G


@njit(cache=True, fastmath=True, inline="always")
def _add(psi, e, b, G):  # type: ignore[no-untyped-def]
    K, p = psi.shape
    for i in range(K):
        for q in range(p):
            b[i] += psi[i, q] * e[q]
            for j in range(K):
                G[i, j] += psi[i, q] * psi[j, q]
