"""Alarm rates of the detectors whose statistic is not a linear function of the noise: bursts are played sample by sample.

Rare alarms come from machines with faults, weighted back to the healthy one by the likelihood ratio of the whole record
(`Mixture`). Thresholds of the regressions depend on every burst; they lie in a narrow band, and only bursts
inside the band (widened threefold) are put to the detector once more for their own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rates_cases import RATES, RateCase
from rates_counting import Rate, counted, weighted
from scipy.special import logsumexp

from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.features.regressors import Regressors, regressors
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.lti.statespace import Array
from benchmarks.support.trials import Trials, trials

COUNTED = 0.1  # rates from here on are counted on healthy bursts, smaller ones weighted
AIMED = (1e-2, 5e-4, 1e-5)  # tails whose points the deflections of the faulty machines are
BAND = 12  # bursts from which the band of thresholds is taken


@dataclass(frozen=True)
class Judge:
    """A detector at several promised rates: does a burst alarm at each of them?"""

    statistics: tuple[object, ...]
    burst: object
    dt: float
    low: Array
    high: Array

    def alarms(self, shown: BurstSamples) -> Array:
        """Return one truth value per rate."""
        first = self.found(0, shown)
        out = np.array(first.statistic > self.high)
        for j in np.flatnonzero((first.statistic > self.low) & (first.statistic <= self.high)):
            again = self.found(int(j), shown)
            out[j] = again.statistic > again.threshold
        return out

    def found(self, j: int, shown: BurstSamples) -> BurstFinding:
        """Return what the detector finds at its rate number j."""
        s = self.statistics[j]
        sums, early = s.step(s.start(self.burst, self.dt), shown)  # type: ignore[attr-defined]
        return early or s.decide(sums, self.burst, self.dt)[0]  # type: ignore[attr-defined, no-any-return]


def judge(case: RateCase, name: str, source: Trials, rates: tuple[float, ...] = RATES) -> Judge:
    """Return the detector with the band its thresholds lie in."""
    found = tuple(case.statistic(name, rate) for rate in rates)
    blank = Judge(found, case.burst, case.dt, np.zeros(0), np.zeros(0))
    seen = np.array(
        [[blank.found(j, source.samples(source.noise(k))).threshold for j in range(len(found))] for k in range(BAND)]
    )
    low, high = seen.min(axis=0), seen.max(axis=0)
    return replace(blank, low=low - (high - low) - 1e-9, high=high + (high - low) + 1e-9)


def played_rates(case: RateCase, name: str, seed: int, runs: int, healthy_runs: int) -> dict[float, Rate]:
    """Return the alarm rates per burst."""
    filters = regressors(case.problem)
    healthy = trials(case.problem, case.burst, filters=filters)
    judged = judge(case, name, healthy)
    hits = np.zeros(len(RATES))
    for k in range(healthy_runs):
        noise = np.random.default_rng([seed, 4, k]).normal(size=(len(healthy.alpha), len(healthy.root)))
        hits += judged.alarms(healthy.samples(noise))
    source, weights = rare(case, name, filters), np.zeros((runs, len(RATES)))
    rng = np.random.default_rng([seed, 7])
    for k in range(runs):
        shown, weight = source.draw(rng)
        weights[k] = weight * judged.alarms(shown)
    return {
        rate: counted(int(hits[j]), healthy_runs) if rate >= COUNTED else weighted(weights[:, j])
        for j, rate in enumerate(RATES)
    }


def rare(case: RateCase, name: str, filters: Regressors) -> Mixture:
    """Return faulty machines an alarm is likely on: the bank's own models, else three severities of every fault."""
    machines = _bank_models(case) if name == "model_bank" else _severities(case, filters)
    found = tuple(trials(case.problem, case.burst, {fault: theta}, filters=filters) for fault, theta in machines)
    which = np.array([case.problem.fault_names.index(fault) for fault, _ in machines])
    return Mixture(found, which, np.array([theta for _, theta in machines]), trials(case.problem, case.burst, filters=filters))


def _bank_models(case: RateCase) -> list[tuple[str, float]]:
    reach = reachable(case.problem)
    models = case.statistic("model_bank", 0.1).models  # type: ignore[attr-defined]
    return [(fault, theta) for fault, theta, _ in models if theta >= 0.99 * reach[fault][0]]


def _severities(case: RateCase, filters: Regressors) -> list[tuple[str, float]]:
    noise, out = noise_driven(case.problem), []
    information = case.burst.samples * (noise.passive + noise.excited(case.burst)[0])
    for q in AIMED:
        for i, (fault, (low, _)) in enumerate(reachable(case.problem).items()):
            out.append((fault, max(-tail_point(q) / float(np.sqrt(information[i])), 0.9 * low)))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Runs of machines each with one fault, weighted back to the healthy one."""

    machines: tuple[Trials, ...]
    which: Array
    severities: Array
    healthy: Trials

    def draw(self, rng: np.random.Generator) -> tuple[BurstSamples, float]:
        """Return samples and their weight, the likelihood of the healthy machine over that of the mixture."""
        machine = self.machines[int(rng.integers(len(self.machines)))]
        samples, series, run = machine.whole(rng.normal(size=(len(machine.alpha), len(machine.root))))
        if not all(self.healthy.filters.exact):
            healthy = self.healthy.log_density(run)
            return samples, _weight(np.array([m.log_density(run) - healthy for m in self.machines]))
        b = np.einsum("tkp,tp->k", series[:, 1:], series[:, 0])[self.which]
        G = np.einsum("tkp,tkp->k", series[:, 1:], series[:, 1:])[self.which]
        return samples, _weight(self.severities * b - self.severities**2 * G / 2)


def _weight(log_ratios: Array) -> float:
    """Return one over the mean likelihood ratio."""
    return float(np.exp(np.log(len(log_ratios)) - logsumexp(log_ratios)))
