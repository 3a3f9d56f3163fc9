"""Playing bursts: the closed loop simulated sample by sample, many bursts kept as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from machines import Case

from afdsvc.detect.burst_detector import BurstSamples
from afdsvc.detect.features.demodulation import Basis
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.excite.simulated_burst import simulate_burst
from afdsvc.lti.statespace import Array
from benchmarks.support.trials import Trials, trials

CHUNK = 50


@dataclass(frozen=True)
class Played:
    """N bursts: normalised residual ``E (N, n, p)``, score ``b (N, K)`` and information ``G (N, K, K)`` of the regression,
    line sums ``B (N, 2 L, p)`` over the steady window, and every burst as detectors are shown it.

    ``y``, ``u`` hold the whole records ``(N, before + n, ...)`` from rest.
    """

    E: Array
    b: Array
    G: Array
    B: Array
    shown: list[BurstSamples]
    y: Array
    u: Array
    before: int

    def __len__(self) -> int:
        return len(self.E)


class Player:
    """Plays the bursts of one case; filters and loops are built once."""

    def __init__(self, case: Case, factor: float = 1.0) -> None:
        self.case, self.burst = case, case.scaled(factor)
        self.problem, self.filters = case.problem, regressors(case.problem)
        self.basis = Basis(tuple(sorted({line.omega for line in self.burst.lines})))
        first, last = window(self.burst)
        self.first, self.last = first, last
        t = np.arange(first, last) * self.problem.plant.dt
        self.phi = np.concatenate([[np.sin(w * t), np.cos(w * t)] for w in self.basis.omega]).T
        self._machines: dict[tuple[tuple[str, float], ...], Trials] = {}

    def machine(self, severities: Mapping[str, float]) -> Trials:
        key = tuple(severities.items())
        if key not in self._machines:
            self._machines[key] = trials(self.problem, self.burst, severities, filters=self.filters)
        return self._machines[key]

    def chunks(self, severities: Mapping[str, float], count: int, seed: int) -> Iterator[Played]:
        """Yield ``count`` bursts of a machine in chunks; the noise follows from the seed."""
        for start in range(0, count, CHUNK):
            size = min(CHUNK, count - start)
            yield self._chunk(self.machine(severities), np.random.default_rng([seed, start]), size)

    def _chunk(self, machine: Trials, rng: np.random.Generator, size: int) -> Played:
        n, p, K = self.burst.samples, self.problem.plant.outputs, len(self.problem.fault_names)
        shown, ys, us = [], [], []
        series = np.empty((size, n, 1 + K, p))
        for i in range(size):
            noise = rng.normal(size=(machine.before + n, p))
            run = simulate_burst(self.problem, machine.alpha, noise @ machine.root.T, loop=machine.loop)
            _, whole = self.filters.step(self.filters.start(), run.r, run.y, run.u)
            series[i] = whole[machine.before :, : 1 + K]
            block = next(b for b in run.blocks(len(run), self.burst, machine.before) if b.burst is not None)
            shown.append(BurstSamples(0, run.dt, whole[machine.before :], block))
            ys.append(run.y)
            us.append(run.u)
        E = np.ascontiguousarray(series[:, :, 0])
        psi = np.moveaxis(series[:, :, 1:], 2, 1).reshape(size, K, n * p)
        b, G = np.einsum("nkt,nt->nk", psi, E.reshape(size, n * p)), psi @ np.swapaxes(psi, 1, 2)
        B = np.swapaxes(self.phi, 0, 1)[None] @ E[:, self.first : self.last]
        return Played(E, b, G, B, shown, np.array(ys), np.array(us), machine.before)
