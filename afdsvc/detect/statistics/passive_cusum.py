"""CUSUM between bursts: information about a fault in the loop's own noise, without excitation.

The log-likelihood ratios use the regressors psi of `regressors`, advanced in blocks of a few milliseconds from the products
that all faults share (`shared`, `products`). They gain information at a random rate: the run length is that of uneven
steps (`uneven`, `arl`), at the mean rate the healthy loop determines, corrected by simulating the loop (`joint_rate`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.burst_detector import BurstFinding, evidence
from afdsvc.detect.features.data_checks import Runs
from afdsvc.detect.features.front_end import filtered
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.features.shared_filter import Filters, shared_regressors
from afdsvc.detect.features.whiteness_gate import NOTHING, PARTS, Gate, GateState, Judgement, Recent
from afdsvc.detect.model_uncertainty import share_near_instability
from afdsvc.detect.statistics.binding_function import products_of_noise
from afdsvc.detect.statistics.cusum import Cusum, CusumState, cusum
from afdsvc.detect.thresholds import average_run_length
from afdsvc.detect.thresholds.cusum_boundary import Models, rate_boundary
from afdsvc.detect.thresholds.deflection_boundary import DeflectionBoundary
from afdsvc.detect.thresholds.joint_false_alarm_rate import joint_rate
from afdsvc.detect.thresholds.regressor_information import NoiseDriven, excursion_steps, faulty_information, noise_driven
from afdsvc.detect.uncertain_parameters import uncertain_parameters
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

BLOCK = 1e-3  # seconds between looks at the CUSUMs
HERMITE = 15  # models averaged over in one direction
RARE = 0.01  # share of machines with a loop near instability, which alarm tens of times as often as promised, that leaves the promise intact

UNPROMISED = (
    "the stated uncertainty of the model takes more than half of the loop's stability margin in {:.2g} % of the machines it allows, so no rate of "
    "alarms between bursts can be promised: state what is uncertain more precisely"
)


@dataclass(frozen=True, slots=True, eq=False)
class PassiveState:
    """Filters, gate, runs of constant values, CUSUMs, samples to stay silent, whether the gate's doubt was
    reported, parts of the gate since a fault was last looked for, nuisances learnt, and the last quiet samples.
    """

    filters: Any
    gate: GateState
    runs: Runs
    cusum: CusumState
    silent: int = 0
    doubted: bool = False
    parts: int = PARTS
    cleaning: Cleaning | None = None
    recent: Recent = NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class PassiveDetector:
    """The detector: CUSUMs ``test`` of the faults ``which (K,)``, samples of silence after an alarm.

    ``unpromised`` says why no rate of alarms can be promised: then what crosses the boundary is not trusted, for that reason.
    """

    name: str
    problem: DetectionProblem
    filters: Filters
    gate: Gate
    which: NDArray[np.intp]
    test: Cusum
    silence: int
    sure: float
    frozen: int
    nuisances: Nuisances = NONE
    unpromised: str = ""

    @property
    def boundary(self) -> float:
        """Boundary of the largest CUSUM."""
        return self.test.boundary

    def delay(self, fault: str, severity: float) -> float:
        """Return the mean time [s] from a fault's onset to the alarm, its CUSUM being at zero then, which is the worst case.

        From the run length in the faulty loop, which brings less information than the healthy one. Infinite for a fault
        below half the severity looked for, on which the CUSUM does not grow; raises `BadInput` for one the loop's noise does
        not show.
        """
        shown = [self.problem.fault_names[i] for i in self.which]
        if fault not in shown:
            raise BadInput(f"the loop's own noise does not show fault '{fault}'; expected one of {', '.join(shown)}")
        k, block = shown.index(fault), self.test.block
        theta, noise = float(self.test.severity[k]), noise_driven(self.problem)
        G = faulty_information(noise, int(self.which[k]), severity) * block
        if not abs(severity) > abs(theta) / 2:
            return math.inf
        step, mu = excursion_steps(noise, self.which[k : k + 1], self.test.severity[k : k + 1], block)[0], abs(theta) * math.sqrt(G)
        looks = average_run_length.run_length(mu, self.boundary, True, bias=theta * (severity - theta) * G, step=float(step))
        return looks * block * self.problem.plant.dt

    def start(self) -> PassiveState:
        """Return the initial state."""
        p = self.problem.plant.outputs
        return PassiveState(self.filters.start(), self.gate.start(0, p), Runs.start(p), self.test.start(), self.gate.settle)

    def step(self, state: PassiveState, block: ResidualBlock) -> tuple[PassiveState, Sequence[Evidence]]:
        """Return the state after the block and the alarms and doubts that fell inside it."""
        found: list[Evidence] = []
        if block.gap:
            state = self._restarted(state, "a gap in the samples")
        filters, pieces = filtered(block, self.filters, state.filters)
        for f in pieces:
            state = replace(state, runs=state.runs.add(f.piece.y)[0])
            if not f.usable:
                state = self._restarted(state, "a sample that is not a finite number")
            elif f.piece.burst is None:
                state = self._quiet(state, f.piece, f.series, found)
            else:
                state = replace(state, cleaning=None)
        return replace(state, filters=filters), found

    def _restarted(self, state: PassiveState, because: str) -> PassiveState:
        return replace(
            state, gate=self.gate.restart(state.gate, because),
            cusum=self.test.start(), silent=self.gate.settle, cleaning=None, recent=NOTHING,
        )

    def _quiet(self, state: PassiveState, piece: ResidualBlock, series: Array, found: list[Evidence]) -> PassiveState:
        """Advance over quiet samples, stopping where a gate part is full and where silence or a CUSUM ends."""
        cleaning, series, kept = self.nuisances.clean(state.cleaning, piece, series, self.gate.part)
        recent = state.recent.add(piece, self._remembered + len(piece))  # so that a doubt inside it has all it looks at
        state, index = replace(state, cleaning=cleaning, recent=recent), np.flatnonzero(kept)
        series = series if len(index) == len(series) else series[kept]
        t = 0
        while t < len(series):
            n = min(len(series) - t, self._to_part(state))
            chunk, k = series[t : t + n], piece.k0 + index[t : t + n]
            if state.silent:
                n = min(n, state.silent)
                state = replace(state, silent=state.silent - n, gate=self.gate.add(state.gate, chunk[:n, :1]))
            else:
                state, n = self._watch(state, chunk, k, piece.dt, found)
            t += n
            if self._to_part(state) == self.gate.part and not state.gate.skip:
                state = self._doubt(state, piece.k0 + int(index[t - 1]), piece.dt, found)
        return state

    def _watch(
        self, state: PassiveState, series: Array, k: NDArray[np.intp], dt: float, found: list[Evidence]
    ) -> tuple[PassiveState, int]:
        after, at, who = self.test.step(state.cusum, series.reshape(len(series), -1))
        n = len(series) if at < 0 else at + 1
        state = replace(state, cusum=after, gate=self.gate.add(state.gate, series[:n, :1]))
        if at < 0:
            return state, n
        found.append(self._alarm(state, who, int(k[at]), dt))
        return replace(state, cusum=self.test.start(), silent=self.silence), n

    def _alarm(self, state: PassiveState, who: int, k: int, dt: float) -> Evidence:
        names = [self.problem.fault_names[i] for i in self.which]
        finding = self.test.finding(state.cusum, who, names, self.problem.severity_range, k)
        return self._evidence(state, finding, k, dt, self.unpromised)

    @property
    def _remembered(self) -> int:
        return self.gate.window + self.gate.settle

    @property
    def doubt_level(self) -> float:
        """Level of the test that runs whenever a part of the gate is full: its false doubts are no more frequent than false alarms."""
        return min(self.gate.level, self.problem.false_alarms.per_hour * self.gate.part * self.problem.plant.dt / 3600)

    def _judgement(self, state: PassiveState, k: int, level: float | None = None) -> Judgement:
        found = self.gate.judge(state.gate, level)
        if found.ok or found.found is None:
            return found
        recent = state.recent.until(k, self._remembered)
        return recent.explained(self.gate, self.filters, self.nuisances, self.problem) or found

    def _evidence(self, state: PassiveState, finding: BurstFinding, k: int, dt: float, complaint: str = "") -> Evidence:
        judgement = self._judgement(state, k)
        still = [i for i, run in enumerate(state.runs.length) if run >= self.frozen]
        complaint = f"sensor '{self._output(still[0])}' stands still" if still else complaint
        return evidence(self.name, self.problem, k, dt, "", finding, judgement, complaint, self.sure)

    def _doubt(self, state: PassiveState, k: int, dt: float, found: list[Evidence]) -> PassiveState:
        """Say once that the quiet data cannot be trusted, again only after they could be in between; see `doubt_level`.

        What a fault may explain is looked at once in as many parts as are remembered: that takes longer than a part.
        """
        if state.gate.sums().n < self.gate.needed:
            return state
        ok = self.gate.judge(state.gate, self.doubt_level).ok
        if not ok and state.parts < PARTS:
            return replace(state, parts=state.parts + 1)
        ok, parts = ok or self._judgement(state, k, self.doubt_level).ok, PARTS if ok else 1
        if not ok and not state.doubted:
            peak = float(state.cusum.g.max(initial=0.0))
            found.append(self._evidence(state, BurstFinding(peak, self.boundary), k, dt))
        return replace(state, doubted=not ok, parts=parts)

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
    """Return the passive CUSUM; raises `BadInput` when the loop's noise holds no information on any fault."""
    noise, filters = noise_driven(problem), shared_regressors(problem)
    passive = noise.passive[: filters.faults]
    which = np.flatnonzero(passive > 1e-12 * max(passive.max(initial=0.0), 1e-300))
    if not len(which):
        raise BadInput(f"detector '{name}': the loop's own noise shows none of the faults; expected a burst for them")
    theta, block, rate = np.full(len(which), severity), max(1, round(BLOCK / problem.plant.dt)), problem.false_alarms.per_hour

    def made() -> tuple[float, DeflectionBoundary]:
        looks = 3600 / (rate * problem.plant.dt * block)
        clock = DeflectionBoundary.of(np.abs(theta) * np.sqrt(block * passive[which]), looks)
        return _boundary(problem, noise, which, theta, block, clock), clock

    boundary, clock = problem.once(made, "passive boundary", severity, rate)
    gate = replace(gate, settle=filters.settling(), estimated=problem.noise_samples)
    doubt = unpromised(problem)
    silence = math.ceil((max(silence_seconds, 3600 / rate) if doubt else silence_seconds) / problem.plant.dt)
    test = cusum(filters.theta[which], theta, range(len(which)), block, boundary, clock)
    return PassiveDetector(name, problem, filters, gate, which, test, silence, sure, frozen, nuisances, doubt)


def unpromised(problem: DetectionProblem) -> str:
    """Return why no rate of alarms between bursts can be promised, "" where one can."""
    near = problem.once(lambda: share_near_instability(problem), "machines near instability")
    return UNPROMISED.format(100 * near) if near > RARE else ""


def _boundary(
    problem: DetectionProblem, noise: NoiseDriven, which: NDArray[np.intp], theta: Array, block: int, clock: DeflectionBoundary
) -> float:
    """Return the boundary of CUSUMs that look at blocks of samples and alarm as often as promised."""
    per_block = problem.false_alarms.per_hour * problem.plant.dt / 3600 * block
    mu = np.abs(theta) * np.sqrt(block * noise.passive[which])
    step, joint, models = excursion_steps(noise, which, theta, block), joint_rate(noise, which, theta, block, clock), _models(problem, noise, which, theta, block)
    return rate_boundary(correlation(noise)[np.ix_(which, which)], mu, step, per_block, joint, models)


def _models(problem: DetectionProblem, noise: NoiseDriven, which: NDArray[np.intp], theta: Array, block: int) -> Models | None:
    """Return the models that the uncertain parameters allow, those of each CUSUM along the direction that shifts its mean most; loops that are
    lost are left out. None for a model that is certain."""
    sd = uncertain_parameters(problem)
    if not sd or problem.uncertain is None:
        return None
    faults = len(problem.fault_names)
    (z, weight), found = np.polynomial.hermite_e.hermegauss(HERMITE), np.zeros((3, len(which), HERMITE))
    for k, i in enumerate(which):
        shift = noise.gram[i, faults:] * list(sd.values())
        way = shift * list(sd.values()) / max(float(np.linalg.norm(shift)), 1e-300)
        for q in range(HERMITE):
            at = dict(zip(sd, (z[q] * way).tolist(), strict=True))
            mean = products_of_noise(problem, problem.fault_names[i], problem.uncertain, at)
            score, information = mean or (0.0, float(noise.passive[i]))
            found[:, k, q] = abs(theta[k]) * math.sqrt(block * information), theta[k] * block * score, weight[q] if mean else 0.0
    return Models(found[0], found[1], found[2] / found[2].sum(axis=1, keepdims=True))


def correlation(noise: NoiseDriven) -> Array:
    """Return the correlations of the noise-driven scores of the faults, shape ``(K, K)``."""
    scale = np.sqrt(np.maximum(np.diag(noise.gram), 1e-300))
    return np.asarray(noise.gram / np.outer(scale, scale))
