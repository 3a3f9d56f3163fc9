"""CUSUM between bursts: what the loop's own noise gives away about a fault, all the time and without excitation.

The log-likelihood ratios use the regressors psi of `regressors`. They gain information at a random rate, but counted in
information instead of samples they are the CUSUM of `arl`, and the run length in samples follows from the mean rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.checks import Runs
from afdsvc.detect.cusum import CusumState, rate_boundary, segment_finding
from afdsvc.detect.gate import Gate, GateState, finite
from afdsvc.detect.noise_driven import NoiseDriven, noise_driven
from afdsvc.detect.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.once import at_rest, stepped
from afdsvc.detect.regressors import Regressors, RegressorState, regressors
from afdsvc.detect.watch import Finding, evidence, pieces
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class PassiveState:
    """Filters, gate, runs of constant values, CUSUMs, samples to stay silent, and whether the gate's doubt was
    reported.
    """

    filters: RegressorState
    gate: GateState
    runs: Runs
    cusum: CusumState
    silent: int = 0
    doubted: bool = False
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PassiveDetector:
    """The detector: severities ``theta (K,)`` of the log-likelihood ratios of the faults ``which (K,)``, boundary,
    samples of silence after an alarm.
    """

    name: str
    problem: DetectionProblem
    filters: Regressors
    gate: Gate
    which: NDArray[np.intp]
    theta: Array
    boundary: float
    silence: int
    sure: float
    frozen: int
    nuisances: Nuisances = NONE

    def start(self) -> PassiveState:
        """Return the initial state."""
        p = self.problem.plant.outputs
        gate = self.gate.start(len(self.filters.names), p)
        cusum = CusumState.start(len(self.which))
        return PassiveState(at_rest(self.filters), gate, Runs.start(p), cusum, self.gate.settle)

    def step(self, state: PassiveState, block: ResidualBlock) -> tuple[PassiveState, Sequence[Evidence]]:
        """Return the state after the block and the alarms and doubts that fell inside it."""
        found: list[Evidence] = []
        if block.gap:
            state = self._restarted(state, "a gap in the samples")
        for piece in pieces(block):
            runs, _ = state.runs.add(piece.y)
            filters, series = stepped(self.filters, state.filters, piece)
            state = replace(state, runs=runs, filters=filters)
            if not finite(series):
                state = self._restarted(state, "a sample that is not a finite number")
            elif piece.burst is None:
                state = self._quiet(state, piece, series, found)
            else:
                state = replace(state, cleaning=None)
        return state, found

    def _restarted(self, state: PassiveState, because: str) -> PassiveState:
        return replace(
            state, filters=at_rest(self.filters), gate=self.gate.restart(state.gate, because),
            cusum=CusumState.start(len(self.which)), silent=self.gate.settle, cleaning=None,
        )

    def _quiet(self, state: PassiveState, piece: ResidualBlock, series: Array, found: list[Evidence]) -> PassiveState:
        """Advance over quiet samples, stopping where a gate part is full and where silence or a CUSUM ends."""
        cleaning, series, kept = self.nuisances.clean(state.cleaning, piece, series, self.gate.part)
        state, index = replace(state, cleaning=cleaning), np.flatnonzero(kept)
        series = series if len(index) == len(series) else series[kept]
        t = 0
        while t < len(series):
            n = min(len(series) - t, self._to_part(state))
            chunk, k = series[t : t + n], piece.k0 + index[t : t + n]
            if state.silent:
                n = min(n, state.silent)
                state = replace(state, silent=state.silent - n, gate=self.gate.add(state.gate, chunk[:n]))
            else:
                state, n = self._watch(state, chunk, k, piece.dt, found)
            t += n
            if self._to_part(state) == self.gate.part and not state.gate.skip:
                state = self._doubt(state, piece.k0 + int(index[t - 1]), piece.dt, found)
        return state

    def _watch(
        self, state: PassiveState, series: Array, k: NDArray[np.intp], dt: float, found: list[Evidence]
    ) -> tuple[PassiveState, int]:
        waves = series[:, 1 + self.which]
        cusum, at, who, _ = state.cusum.step(series[:, 0], waves, waves, self.theta, self.boundary, 0.0)
        n = len(series) if at < 0 else at + 1
        state = replace(state, cusum=cusum, gate=self.gate.add(state.gate, series[:n]))
        if at < 0:
            return state, n
        found.append(self._alarm(state, who, int(k[at]), dt))
        return replace(state, cusum=CusumState.start(len(self.which)), silent=self.silence), n

    def _alarm(self, state: PassiveState, who: int, k: int, dt: float) -> Evidence:
        names = [self.problem.fault_names[i] for i in self.which]
        g = float(state.cusum.g[who])
        finding = segment_finding(state.cusum, who, names, g, self.boundary, self.problem.severity_range, k)
        return self._evidence(state, finding, k, dt)

    def _evidence(self, state: PassiveState, finding: Finding, k: int, dt: float) -> Evidence:
        judgement = self.gate.judge(state.gate, self.filters.names, self.filters.bounds)
        still = [i for i, run in enumerate(state.runs.length) if run >= self.frozen]
        complaint = f"sensor '{self._output(still[0])}' stands still" if still else ""
        return evidence(self.name, self.problem.machine, k, dt, "", finding, judgement, complaint, self.sure)

    def _doubt(self, state: PassiveState, k: int, dt: float, found: list[Evidence]) -> PassiveState:
        """Say once that the quiet data cannot be trusted, again only after they could be in between."""
        if state.gate.sums().n < self.gate.needed:
            return state
        ok = self.gate.judge(state.gate, self.filters.names, self.filters.bounds).ok
        if not ok and not state.doubted:
            peak = float(state.cusum.g.max(initial=0.0))
            found.append(self._evidence(state, Finding(peak, self.boundary), k, dt))
        return replace(state, doubted=not ok)

    def _to_part(self, state: PassiveState) -> int:
        """Return the samples until the gate's present part is full."""
        return state.gate.skip + self.gate.part - state.gate.now.n

    def _output(self, i: int) -> str:
        names = self.problem.output_names
        return names[i] if i < len(names) else str(i)


def passive_detector(
    name: str, problem: DetectionProblem, gate: Gate, severity: float, silence_seconds: float, sure: float, frozen: int,
    nuisances: Nuisances = NONE,
) -> PassiveDetector:
    """Return the passive CUSUM; raises `BadInput` when the loop's noise tells nothing about any fault."""
    filters = regressors(problem)
    noise = noise_driven(problem, filters)
    passive = noise.passive[: filters.faults]
    which = np.flatnonzero(passive > 1e-12 * max(passive.max(initial=0.0), 1e-300))
    if not len(which):
        raise BadInput(f"detector '{name}': the loop's own noise shows none of the faults; a burst is wanted for them")
    theta = np.full(len(which), severity)
    per_sample = problem.false_alarms.per_hour * problem.plant.dt / 3600
    mu = np.abs(theta) * np.sqrt(passive[which])
    wrong = noise.gram[: filters.faults, filters.faults :][which] * filters.sd[None, :]
    bias = np.abs(theta) * np.linalg.norm(wrong, axis=1)
    boundary = rate_boundary(correlation(noise)[np.ix_(which, which)], mu, bias, per_sample)
    gate = replace(gate, settle=filters.settling())
    silence = math.ceil(silence_seconds / problem.plant.dt)
    return PassiveDetector(name, problem, filters, gate, which, theta, boundary, silence, sure, frozen, nuisances)


def correlation(noise: NoiseDriven) -> Array:
    """Return the correlations of the noise-driven scores of the faults, shape ``(K, K)``."""
    scale = np.sqrt(np.maximum(np.diag(noise.gram), 1e-300))
    return np.asarray(noise.gram / np.outer(scale, scale))
