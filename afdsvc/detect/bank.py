"""A bank of models: one predictor for every fault at several severities; the most likely wins.

Every model's likelihood against the healthy one has mean 1 without a fault, so by Markov's inequality and the union
of K models ``max_k log LR > ln(K / P_FA)`` happens at most with probability P_FA. The bank's cost grows with the
number of models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import logsumexp

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstSamples, Finding
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.features.quiet_window import between
from afdsvc.detect.features.regressors import predictor_gain, whitener
from afdsvc.detect.isolation import Fit
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import Array, StateSpace


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
            ratio[k] = _add(counted[:, 0], counted[:, 1 + k], ratio[k])
        return BankSums(tuple(after for _, after in run), ratio, sums.n + len(signals), cleaning), None

    def decide(self, sums: BankSums, burst: Burst, dt: float) -> Sequence[Finding]:
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
        return [Finding(float(sums.ratio.max()), threshold, tuple(fits), weights, {"models": float(len(self.models))})]

    def _spacing(self, own: list[int]) -> float:
        """Return the standard deviation of a severity known to one step of the bank only."""
        severities = sorted(self.models[k][1] for k in own)
        return float(np.max(np.diff([*severities, 0.0]))) / math.sqrt(12)


@njit(cache=True)
def _add(e0, e, ratio):  # type: ignore[no-untyped-def]
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
