"""CUSUM during a burst, against the waves the faults would cause: a large fault is detected before the burst ends.

In the steady part of a burst every wave is a combination of the sines and cosines of its lines, so a block of samples says
all it has to say by its products with those (`products`). Small and large faults want different severities in the ratio: the
smallest deflection looked for is the one that a test at the end of the burst would find surely, and twice and four times
that run beside it. The boundary is that of the largest of all these CUSUMs (`crossing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.features.demodulation import Basis, BasisSums, line_frequencies, window
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.model_uncertainty import models
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.cusum import Cusum, CusumState, cusum
from afdsvc.detect.statistics.fault_curves import FaultCurves, fault_curves
from afdsvc.detect.thresholds.burst_crossing import CrossingNoise, paths
from afdsvc.detect.thresholds.power import required_deflection
from afdsvc.lti.statespace import Array

SHORTEST = 5e-3  # seconds of a block
BLOCKS = 40  # of a burst, where its samples divide by that; fewer of short ones
UNSEEN = 1e-3  # deflection of a wave over the whole burst below which the fault is left out
DOUBLINGS = 3  # deflections looked for, each twice the one before
SURE = 0.99  # probability with which the smallest would be found at the end of the burst
SAME = 1e-6  # severities closer than this are one hypothesis


@dataclass(frozen=True, slots=True, eq=False)
class CusumPlan:
    """The CUSUMs of one burst: faults seen ``(K,)``, the waves of all hypotheses in standard deviations block by block
    ``(blocks, H, D)``, the fault of each ``(H,)``."""

    seen: NDArray[np.intp]
    waves: Array
    of: NDArray[np.intp]
    cusum: Cusum

    @property
    def boundary(self) -> float:
        """Boundary of the largest CUSUM."""
        return self.cusum.boundary


@dataclass(frozen=True, slots=True, eq=False)
class ActiveSums:
    """What is looked for, the burst, its CUSUMs, and the nuisances learnt so far."""

    plan: CusumPlan
    burst: Burst
    state: CusumState
    cleaning: Cleaning | None = None

    @property
    def boundary(self) -> float:
        """Boundary of the largest CUSUM."""
        return self.plan.boundary


@dataclass(frozen=True, slots=True, eq=False)
class ActiveCusum:
    """CUSUM over the steady part of a burst. ``deflection`` is the smallest looked for, over the whole burst; 0: what a
    test at its end would find with probability 0.99 at the promised alarm rate. ``nuisances`` are projected out.
    """

    problem: DetectionProblem
    deflection: float = 0.0
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> ActiveSums:
        """Return the state before the first sample."""
        about = (self.deflection, self.problem.false_alarms.per_burst, burst.content, dt)
        plan = self.problem.once(lambda: self.plan(burst, dt), "cusum plan", *about)
        return ActiveSums(plan, burst, plan.cusum.start())

    def plan(self, burst: Burst, dt: float) -> CusumPlan:
        """Return hypotheses and boundary for a burst, computed anew.

        Raises `BadInput` for a burst that is not a sum of sines.
        """
        line_frequencies(burst)
        ordered = tuple(sorted(burst.lines, key=lambda line: line.omega))
        block, roots = _blocks(burst, ordered, dt)
        curves = fault_curves(self.problem, ordered)
        severities, of = self._severities(curves, roots)
        fitted, seen = np.unique(of, return_index=True)[1], np.unique(of)
        points = [curves.at(curves.names[i], [s])[0] for i, s in zip(of, severities, strict=True)]
        unit = np.array([np.swapaxes(c, 0, 1) / s for c, s in zip(points, severities, strict=True)])
        unit = unit.reshape(len(of), self.problem.plant.outputs, 2 * len(ordered))
        waves = np.array([[(R @ c).ravel() for c in points] for R in roots])
        boundary = self._boundary(waves, ordered, roots) if len(of) else math.inf
        return CusumPlan(seen, waves, of, cusum(unit, severities, fitted.tolist(), block, boundary))

    def step(self, sums: ActiveSums, samples: BurstSamples) -> tuple[ActiveSums, BurstFinding | None]:
        """Return the state after the samples and a finding at the first crossing."""
        omega = np.array(line_frequencies(sums.burst))
        flat = _with_lines(np.ascontiguousarray(samples.series[:, 0]), omega, samples.first, samples.dt)
        cleaning, clean, _ = self.nuisances.clean(sums.cleaning, samples.block, flat[:, None])
        first, last = window(sums.burst)
        a, b = max(first - samples.first, 0), max(last - samples.first, 0)
        state, at, who = sums.plan.cusum.step(sums.state, clean[a:b, 0])
        sums = replace(sums, state=state, cleaning=cleaning)
        return sums, None if at < 0 else self._finding(sums, who, samples.first + a + at)

    def decide(self, sums: ActiveSums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return the finding at the end of a burst that did not cross the boundary."""
        who = int(np.argmax(sums.state.g)) if len(sums.plan.of) else 0
        return [self._finding(sums, who, burst.samples - 1)]

    def _finding(self, sums: ActiveSums, who: int, sample: int) -> BurstFinding:
        names = [self.problem.fault_names[i] for i in sums.plan.seen]
        return sums.plan.cusum.finding(sums.state, who, names, self.problem.severity_range, sample)

    def _severities(self, curves: FaultCurves, roots: Array) -> tuple[Array, NDArray[np.intp]]:
        """Return the severities of all hypotheses and the fault of each: smallest deflection first."""
        smallest = self.deflection or required_deflection(self.problem.false_alarms.per_burst, SURE)
        reach, found = reachable(self.problem), []
        for i, name in enumerate(curves.names):
            low = 0.999 * reach[name][0]
            if _deflection(curves, name, low, roots) > UNSEEN:
                own = [_severity(curves, name, low, smallest * 2**k, roots) for k in range(DOUBLINGS)]
                found += [(s, i) for k, s in enumerate(own) if not k or abs(s - own[k - 1]) > SAME]
        return np.array([s for s, _ in found]), np.array([i for _, i in found], dtype=np.intp)

    def _boundary(self, waves: Array, ordered: Sequence[Line], roots: Array) -> float:
        noise = None if not self.problem.uncertainty else self._noise(ordered, roots)
        return paths(waves, noise).boundary(self.problem.false_alarms.per_burst)

    def _noise(self, ordered: Sequence[Line], roots: Array) -> CrossingNoise:
        """Return what an uncertain model sends into every block."""
        whole = np.asarray(np.linalg.cholesky(np.einsum("kij,kil->jl", roots, roots))).T
        found = models(self.problem, ordered, whole)
        points = np.linalg.solve(whole, found.waves.reshape(len(found.weights), len(whole), -1))
        mean = np.einsum("kij,qjp->qkip", roots, points).reshape(len(points), len(roots), -1)
        return CrossingNoise(found.weights, mean, np.asarray(np.linalg.cholesky(found.covariances)))


def _blocks(burst: Burst, ordered: Sequence[Line], dt: float) -> tuple[int, Array]:
    """Return the samples of a block, and R of every block ``(blocks, 2 L, 2 L)``: a wave of coefficients c adds R c."""
    first, last = window(burst)
    block = max((last - first) // max(1, min(BLOCKS, int((last - first) * dt / SHORTEST))), 1)
    count = max((last - first) // block, 1)  # all that are full, which may be more
    basis = Basis(tuple(line.omega for line in ordered))
    empty = BasisSums.empty(basis, 1)
    grams = [empty.add(basis, first + k * block, dt, np.zeros((block, 1))).G for k in range(count)]
    values, vectors = np.linalg.eigh(np.array(grams))
    return block, np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)


def _deflection(curves: FaultCurves, name: str, severity: float, roots: Array) -> float:
    return float(np.linalg.norm(roots @ curves.at(name, [severity])[0]))


def _severity(curves: FaultCurves, name: str, low: float, deflection: float, roots: Array) -> float:
    """Return the loss with the required deflection, ``low`` where the fault cannot cause that much."""
    theta = 0.05 * low
    for _ in range(6):  # the deflection is not quite proportional to the severity
        theta = max(low, theta * deflection / _deflection(curves, name, theta, roots))
    return theta


@njit(cache=True)
def _with_lines(e, omega, first, dt):  # type: ignore[no-untyped-def]
    """Return residual and the sines and cosines of the lines, ``(n, p + 2 L)``."""
    n, p = e.shape
    flat = np.empty((n, p + 2 * omega.size))
    for t in range(n):
        for q in range(p):
            flat[t, q] = e[t, q]
        for i in range(omega.size):
            angle = omega[i] * ((first + t) * dt)
            flat[t, p + 2 * i], flat[t, p + 2 * i + 1] = np.sin(angle), np.cos(angle)
    return flat
