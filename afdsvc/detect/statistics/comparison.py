"""Statistics to compare with: two that know no faults, the thesis' matched filter as published, and a bank of models.

*Energy and largest sample* of the white residual need no excitation; their thresholds are exact: chi-squared with ``n p`` degrees of
freedom, and the largest of ``n p`` independent normals.

*As published*: for each output the line that shows most there is correlated with unit sines at the phases of the faults of one design
severity; the best phase names the fault, ``T = sum r A sin(w n + phi)`` is compared with ``gamma = sqrt(sigma^2 N A^2
/ 2) Q^-1(P_FA)``, the threshold of a single template. With ``A = A_0`` (one amplitude for all) or ``A = A_phi`` (that
of the phase found) the numbers differ but A cancels between T and gamma: both are one test. Its true false-alarm rate
is that of the largest of all phases on all outputs, several times P_FA. (A. K. Sekunda, "Fault Diagnosis and Identification of
Electro-Mechanical Systems", PhD thesis, DTU 2017, eqs. 5.19-5.30, publication P4 eqs. 27-46; the excitation enters with unit amplitude.)

*Bank*: one predictor for every fault at several severities; the most likely wins. Every model's likelihood against the healthy one has
mean 1 without a fault, so by Markov's inequality and the union of K models ``max_k log LR > ln(K / P_FA)`` happens at most with
probability P_FA. The cost grows with the number of models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import logsumexp, ndtri
from scipy.stats import chi2

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.features.demodulation import Basis, BasisSums
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.features.regressors import predictor_gain, whitener
from afdsvc.detect.features.whiteness_gate import between
from afdsvc.detect.isolation import Fit
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class EnergySums:
    """Samples, sum of squares and largest absolute value of the normalised residual, nuisances learnt so far."""

    n: int
    energy: float
    largest: float
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True)
class Energy:
    """The statistic over a burst: chi-squared energy, or with ``peak`` the largest sample (a limit check), after the
    ``nuisances`` are projected out."""

    outputs: int
    false_alarm: float
    peak: bool
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> EnergySums:
        """Return empty sums."""
        return EnergySums(0, 0.0, 0.0)

    def step(self, sums: EnergySums, samples: BurstSamples) -> tuple[EnergySums, None]:
        """Return the sums with the samples added."""
        cleaning, clean, kept = self.nuisances.clean(sums.cleaning, samples.block, samples.series[:, :1])
        e = clean[kept, 0]
        energy, largest = _add_energy(e, sums.energy, sums.largest)
        return EnergySums(sums.n + len(e), energy, largest, cleaning), None

    def decide(self, sums: EnergySums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding without any fault in it."""
        count = sums.n * self.outputs
        if self.peak:
            each = -np.expm1(np.log1p(-self.false_alarm) / count)
            return [BurstFinding(sums.largest, -float(ndtri(each / 2)))]
        return [BurstFinding(sums.energy, float(chi2.isf(self.false_alarm, count)))]


@njit(cache=True)
def _add_energy(e, energy, largest):  # type: ignore[no-untyped-def]
    for t in range(e.shape[0]):
        for i in range(e.shape[1]):
            energy += e[t, i] * e[t, i]
            largest = max(largest, abs(e[t, i]))
    return energy, largest


UNSEEN = 1e-9  # an amplitude below this share of the largest belongs to no phase


@dataclass(frozen=True, slots=True, eq=False)
class PublishedSums:
    """Sums over the steady part of a burst, and nuisances learnt so far."""

    lines: BasisSums
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PublishedFilter:
    """The statistic; ``follow_phase`` chooses A_phi instead of A_0, ``severity`` is that of the design. ``nuisances``, which
    were not published, are projected out of the residual first.

    Raises `BadInput` for a severity at which the loop is lost: its published phases belong to no signal.
    """

    problem: DetectionProblem
    follow_phase: bool
    severity: float = -0.1
    nuisances: Nuisances = NONE

    def __post_init__(self) -> None:
        for name, (low, high) in reachable(self.problem).items():
            if not low <= self.severity <= high:
                raise BadInput(
                    f"severity {self.severity:g} of fault '{name}' makes the loop unstable; expected one from {low:.3g} to {high:.3g}"
                )

    def start(self, burst: Burst, dt: float) -> PublishedSums:
        """Return empty sums."""
        return PublishedSums(BasisSums.empty(_basis(burst), self.problem.plant.outputs))

    def step(self, sums: PublishedSums, samples: BurstSamples) -> tuple[PublishedSums, None]:
        """Return the sums with the steady samples added; the residual is taken output by output, not jointly
        whitened.
        """
        burst = samples.block.burst
        assert burst is not None  # noqa: S101 - the frame hands over samples of bursts only
        first, last = window(burst)
        a, b = max(first - samples.first, 0), max(last - samples.first, 0)
        cleaning, clean, _ = self.nuisances.clean(sums.cleaning, samples.block, samples.block.r[:, None])
        r = clean[a:b, 0]
        lines = sums.lines.add(_basis(burst), samples.first + a, samples.dt, r) if len(r) else sums.lines
        return PublishedSums(lines, cleaning), None

    def decide(self, sums: PublishedSums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding for every output; raises `Refused` for a burst without a steady sample."""
        if not sums.lines.n:
            raise Refused(
                f"burst '{burst.name}' of {burst.samples} samples is all ramp and settling; expected a steady part for the "
                "published statistic"
            )
        waves = self._amplitudes(burst)
        return [self._output(sums.lines, waves, i) for i in range(self.problem.plant.outputs)]

    def _amplitudes(self, burst: Burst) -> ComplexArray:
        """Return complex amplitudes ``(K, L, p)`` of the residual for the design severity."""
        ordered = sorted(burst.lines, key=lambda line: line.omega)
        response = loop_response(self.problem, [line.omega for line in ordered])
        drive = np.array([line.amplitude * np.exp(1j * line.phase) for line in ordered])
        waves = []
        for name in self.problem.fault_names:
            r = response.paths(name, [self.severity]).r[0]
            waves.append(np.stack([r[k, :, line.input] * drive[k] for k, line in enumerate(ordered)]))
        return np.array(waves)

    def _output(self, sums: BasisSums, waves: ComplexArray, i: int) -> BurstFinding:
        k = int(np.argmax(np.abs(waves[:, :, i]).max(axis=0)))
        a = waves[:, k, i]
        seen = np.flatnonzero(np.abs(a) > UNSEEN * np.abs(waves).max())
        name = self.problem.output_names[i] if i < len(self.problem.output_names) else str(i)
        if not len(seen):
            return BurstFinding(0.0, float("inf"), output=name)
        sine, cosine = sums.B[2 * k, i], sums.B[2 * k + 1, i]
        unit = np.array([np.real(np.exp(-1j * np.angle(v)) * (sine + 1j * cosine)) for v in a[seen]])
        found = int(np.argmax(unit))
        A = abs(a[seen[found]]) if self.follow_phase else float(np.abs(a[seen]).max())
        sigma = float(np.sqrt(self.problem.covariance[i, i]))
        gamma = sigma * A * np.sqrt(sums.n / 2) * tail_point(self.problem.false_alarms.per_burst)
        fits = tuple(self._fit(int(j), a, float(u), sums.n, sigma) for j, u in zip(seen, unit, strict=True))
        chosen = self.problem.fault_names[seen[found]]
        weights = {f.fault: float(f.fault == chosen) for f in fits}
        parts = {"amplitude": 2 * float(unit[found]) / sums.n, "phase_deg": float(np.degrees(np.angle(a[seen[found]])) % 360)}
        return BurstFinding(A * float(unit[found]), float(gamma), fits, weights, parts, name)

    def _fit(self, j: int, a: ComplexArray, unit: float, n: int, sigma: float) -> Fit:
        """Return the severity read off the amplitude in proportion to that of the design."""
        per = self.severity / float(abs(a[j]))
        value, sd = 2 * unit / n * per, sigma * float(np.sqrt(2 / n)) * abs(float(per))
        likelihood = unit**2 / (n * sigma**2)
        return Fit(self.problem.fault_names[j], float(np.clip(value, -1.0, 0.0)), sd, likelihood, likelihood)


def _basis(burst: Burst) -> Basis:
    return Basis(tuple(sorted({line.omega for line in burst.lines})))


@dataclass(frozen=True, slots=True, eq=False)
class BankSums:
    """States of the predictors, the log likelihood ratio of every model, shape ``(K,)``, nuisances learnt so far."""

    states: tuple[Array, ...]
    ratio: Array
    n: int
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """The statistic; ``models`` are (fault, severity, predictor from ``[y; u]`` to its normalised error); ``nuisances`` are
    projected out of every error."""

    models: tuple[tuple[str, float, StateSpace], ...]
    false_alarm: float
    settle: int
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> BankSums:
        """Return predictors at rest; their first ``settle`` samples are not counted."""
        return BankSums(tuple(np.zeros(m.order) for _, _, m in self.models), np.zeros(len(self.models)), 0)

    def step(self, sums: BankSums, samples: BurstSamples) -> tuple[BankSums, None]:
        """Return the sums with the samples added."""
        signals = np.hstack([samples.block.y, samples.block.u])
        run = [simulate(model, signals, x) for (_, _, model), x in zip(self.models, sums.states, strict=True)]
        errors = np.stack([samples.series[:, 0], *(e for e, _ in run)], axis=1)
        skip = min(max(self.settle - sums.n, 0), len(signals))
        block = between(samples.block, skip, len(signals))
        cleaning, clean, kept = self.nuisances.clean(sums.cleaning, block, errors[skip:])
        counted, ratio = clean[kept], sums.ratio.copy()
        for k in range(len(self.models)):
            ratio[k] = _add_ratio(counted[:, 0], counted[:, 1 + k], ratio[k])
        return BankSums(tuple(after for _, after in run), ratio, sums.n + len(signals), cleaning), None

    def decide(self, sums: BankSums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding: the likeliest model and the weights of the faults."""
        names = list(dict.fromkeys(name for name, _, _ in self.models))
        evidence, fits = [], []
        for name in names:
            own = [k for k, (n, _, _) in enumerate(self.models) if n == name]
            best = max(own, key=lambda k: sums.ratio[k])
            evidence.append(float(logsumexp(sums.ratio[own])) - math.log(len(own)))
            fits.append(Fit(name, self.models[best][1], self._spacing(own), float(sums.ratio[best]), evidence[-1]))
        total = logsumexp(evidence)
        weights = {n: float(np.exp(v - total)) for n, v in zip(names, evidence, strict=True)}
        threshold = math.log(len(self.models) / self.false_alarm)
        return [BurstFinding(float(sums.ratio.max()), threshold, tuple(fits), weights, {"models": float(len(self.models))})]

    def _spacing(self, own: list[int]) -> float:
        """Return the standard deviation of a severity known to one step of the bank only."""
        severities = sorted(self.models[k][1] for k in own)
        return float(np.max(np.diff([*severities, 0.0]))) / math.sqrt(12)


@njit(cache=True)
def _add_ratio(e0, e, ratio):  # type: ignore[no-untyped-def]
    """Add the log likelihood ratio sample by sample, so that blocks of any size give the same bits."""
    for t in range(e.shape[0]):
        for i in range(e.shape[1]):
            ratio += 0.5 * (e0[t, i] * e0[t, i] - e[t, i] * e[t, i])
    return ratio


def bank(
    problem: DetectionProblem, severities: Sequence[float], settle: int, nuisances: Nuisances = NONE
) -> Bank:
    """Return the bank of all faults at the given severities; models whose predictor is unstable are left out."""
    Kp, Li = predictor_gain(problem, problem.augmented.plant), whitener(problem.covariance)
    models = []
    for name in problem.fault_names:
        for severity in severities:
            g = problem.augmented.close({name: severity})
            A = g.A - Kp @ g.C
            if is_stable(A, g.dt):
                B = np.hstack([Kp, g.B - Kp @ g.D])
                direct = np.hstack([np.eye(g.outputs), -g.D])
                models.append((name, float(severity), StateSpace(A, B, -Li @ g.C, Li @ direct, g.dt)))
    return Bank(tuple(models), problem.false_alarms.per_burst, settle, nuisances)
