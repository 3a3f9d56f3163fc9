"""Faults whose residual is not linear in their severity: regression repeated at the severity found.

The samples of a burst are kept (as many as the burst has, no more). For each fault the predictor is rebuilt at the
present estimate, its error and the derivative of the error are computed from the recorded ``[y; u]``, and a
Gauss-Newton step moves the estimate. The first samples, in which the predictor forgets the state it did not know, are
left out. For gain faults of a stable plant with output noise one step is exact and nothing is gained over
`regression`.

The predictor of a faulty model is its own steady one where the noises are stated; else the gain stays the nominal one, and where process noise
is large severities of sensors are found too small. Errors are weighed by the nominal covariance: its change with severity, which would
add a little precision, is not used.

Slopes are driven by the very noise they are compared with. Without a fault the first step is that of `regression`, and mean and
variance of its signed root are taken out as there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.features.nuisances import NONE, Nuisances
from afdsvc.detect.features.regressors import predictor_gain, whitener
from afdsvc.detect.features.whiteness_gate import between
from afdsvc.detect.isolation import Fit, anything_log_evidence, limited, linear_fit, weights
from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.regressor_information import NoiseDriven, noise_driven
from afdsvc.errors import AfdsvcError, Refused
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations

STEPS = 12
NUDGE = 1e-4  # severity by which derivatives are taken


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """The blocks so far, and the excited lines for the hypothesis of an unknown fault."""

    blocks: tuple[ResidualBlock, ...]
    lines: BasisSums

    def whole(self) -> ResidualBlock:
        """Return the blocks as one."""
        first = self.blocks[0]
        aux = {name: np.concatenate([b.aux[name] for b in self.blocks]) for name in first.aux}
        each = ((b.r, b.beta, b.u, b.y, b.alpha) for b in self.blocks)
        r, beta, u, y, alpha = (np.concatenate(parts) for parts in zip(*each, strict=True))
        return replace(first, r=r, beta=beta, u=u, y=y, alpha=alpha, aux=aux)


@dataclass(frozen=True, slots=True, eq=False)
class Iterated:
    """The statistic for one machine; ``nuisances`` are projected out of every prediction error."""

    problem: DetectionProblem
    Li: Array
    settle: int
    noise: NoiseDriven
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> Recorded:
        """Return an empty record; raises `Refused` for a burst that is over before the predictor has forgotten its start."""
        if not burst.samples > self.settle:
            raise Refused(f"the predictor forgets its start in {self.settle} samples; the burst has {burst.samples}, play a longer one")
        return Recorded((), BasisSums.empty(self._basis(burst, False), self.problem.plant.outputs))

    def step(self, sums: Recorded, samples: BurstSamples) -> tuple[Recorded, None]:
        """Return the record with the samples added."""
        block, angle = samples.block, self.nuisances.angles(samples.block)
        basis = self._basis(block.burst, angle is not None)
        lines = sums.lines if sums.lines.n else BasisSums.empty(basis, self.problem.plant.outputs)
        lines = lines.add(basis, samples.first, samples.dt, samples.series[:, 0], angle)
        return Recorded((*sums.blocks, block), lines), None

    def decide(self, sums: Recorded, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding for all outputs together."""
        signals = sums.whole()
        healthy = self._error({}, signals)
        scores = np.array([self._slope(name, 0.0, signals) for name in self.problem.fault_names])
        seen = np.flatnonzero(np.sum(scores**2, axis=1) > 1e-12)
        if healthy is None or not len(seen):
            return [BurstFinding(0.0, float("inf"))]
        fits = [self._fit(name, signals, healthy) for name in self.problem.fault_names]
        h = maximum.maximum_threshold(_gram_vectors(scores[seen]), self.problem.false_alarms.per_burst)
        basis = self._basis(burst, self.nuisances.turning(signals))
        other = anything_log_evidence(project(sums.lines, basis).z) if basis.omega else None
        samples = len(healthy) // len(self.Li)
        mean, sd = (v[: len(fits)] for v in self.noise.signed_root(samples, burst))
        root, length = np.array([_signed_root(f) for f in fits]), np.linalg.norm(scores, axis=1)
        standard, parts = ((root - mean) / sd)[seen], {"samples": float(samples)}
        slopes = -(scores[seen] @ scores.T) / (length[seen] * sd[seen])[:, None]
        found = tuple(limited(f, standard - h, slopes[:, i]) for i, f in enumerate(fits))
        return [BurstFinding(float(standard.max()), h, found, weights(fits, other), parts)]

    def _fit(self, name: str, signals: ResidualBlock, healthy: Array) -> Fit:
        """Return the likeliest severity of one fault; ``healthy`` is the error of the healthy model."""
        low, high = self.problem.severity_range
        theta, rest, slope = 0.0, healthy, self._slope(name, 0.0, signals)
        for _ in range(STEPS):
            if not slope @ slope > 1e-12:
                return Fit(name, theta, math.inf, 0.0, 0.0)
            moved, better = self._moved(name, theta, rest, slope, signals)
            if abs(moved - theta) < 1e-7:
                break
            theta, rest, slope = moved, better, self._slope(name, moved, signals)
        gain, information = 0.5 * float(healthy @ healthy - rest @ rest), float(slope @ slope)
        around = linear_fit(name, float(rest @ slope), information, (low - theta, high - theta))
        return Fit(name, theta, around.sd, gain, gain + around.log_evidence)

    def _moved(self, name: str, theta: float, rest: Array, slope: Array, signals: ResidualBlock) -> tuple[float, Array]:
        """Return the severity after a Gauss-Newton step and its error, the step halved until the fit is better."""
        low, high = self.problem.severity_range
        step = float(rest @ slope) / float(slope @ slope)
        for _ in range(10):
            moved = min(max(theta + step, low), high)
            error = self._error({name: moved}, signals)
            if error is not None and error @ error < rest @ rest:
                return moved, error
            step /= 2
        return theta, rest

    def _slope(self, name: str, theta: float, signals: ResidualBlock) -> Array:
        """Return minus the derivative of the error by the severity; 0 where a neighbour has no stable predictor."""
        ends = [self._error({name: theta + s * NUDGE}, signals) for s in (-1, 1)]
        if ends[0] is None or ends[1] is None:
            return np.zeros_like(self._settled(signals, np.zeros_like(signals.y)))
        return np.asarray((ends[0] - ends[1]) / (2 * NUDGE))

    def _error(self, severities: Mapping[str, float], signals: ResidualBlock) -> Array | None:
        """Return the normalised prediction error after settling, flattened; None when there is no stable predictor."""
        f = _predictor(self.problem, severities)
        if f is None or not is_stable(f.A, f.dt):
            return None
        return self._settled(signals, simulate(f, np.hstack([signals.y, signals.u]))[0] @ self.Li.T)

    def _settled(self, signals: ResidualBlock, e: Array) -> Array:
        """Return errors ``(n, p)`` without nuisances, flattened, settling and the samples that were spent on them left out."""
        block = between(signals, min(self.settle, len(signals)), len(signals))
        _, clean, kept = self.nuisances.clean(None, block, e[len(e) - len(block) :, None])
        return np.asarray(clean[kept].ravel())

    def _basis(self, burst: Burst | None, turning: bool) -> Basis:
        return self.nuisances.basis(() if burst is None else tuple(sorted({line.omega for line in burst.lines})), turning)


def iterated(problem: DetectionProblem, settle: int, nuisances: Nuisances = NONE) -> Iterated:
    """Return the statistic for one machine; the first ``settle`` samples of every burst are left out."""
    return Iterated(problem, whitener(problem.covariance), settle, noise_driven(problem), nuisances)


def _predictor(problem: DetectionProblem, severities: Mapping[str, float]) -> StateSpace | None:
    """Return the steady predictor of the machine with faults, from ``[y; u]`` to its error; with the nominal gain where the noises are not stated."""
    g = problem.augmented.close(severities)
    if problem.output_cov is None:
        Kp = predictor_gain(problem, problem.augmented.plant)
        return StateSpace(g.A - Kp @ g.C, np.hstack([Kp, g.B - Kp @ g.D]), -g.C, np.hstack([np.eye(g.outputs), -g.D]), g.dt)
    try:
        return innovations(g, problem.output_cov, problem.process_cov, problem.cross_cov).filter
    except AfdsvcError:
        return None


def _signed_root(fit: Fit) -> float:
    return math.copysign(math.sqrt(max(2 * fit.log_likelihood, 0.0)), -fit.severity)


def _gram_vectors(scores: Array) -> Array:
    gram = scores @ scores.T
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

