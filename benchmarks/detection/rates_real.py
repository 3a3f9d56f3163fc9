"""The shipped detectors themselves, fed sample by sample, against the short routes of the other files on the same noise.

One long record holds many bursts with quiet stretches between them. Every detector is built as a site would build it, gate and
all, and shown the record in blocks; the short routes are given the noise that was drawn. Their decisions must be the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from rates_baselines import BASELINES
from rates_cases import DESIGNS, RateCase
from rates_lines import LINE_DETECTORS, PUBLISHED, alarm_region
from rates_regression import REGRESSIONS, loop, statistics, threshold
from rates_sequential import cusum_alarms, passive_alarms, watch

from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.features.demodulation import Basis, BasisSums, window
from afdsvc.excite.simulated_burst import SimulatedBurst, simulate_burst
from afdsvc.lti.statespace import Array
from afdsvc.testing.machines import with_rate
from benchmarks.support.trials import trials

QUIET = 1000  # samples between bursts


@dataclass(frozen=True)
class Agreement:
    """Bursts, alarms of the detector and of the short route, decisions that differ, and bursts the gate refused to judge."""

    bursts: int
    alarms: int
    short: int
    differ: int
    refused: int


@dataclass(frozen=True)
class Record:
    """Many bursts of a healthy machine: normalised noise ``(n, p)`` and the signals it made."""

    case: RateCase
    noise: Array
    run: SimulatedBurst
    bursts: int

    @property
    def period(self) -> int:
        return QUIET + self.case.burst.samples

    def blocks(self) -> Iterator[ResidualBlock]:
        """Yield the record, every quiet stretch and every burst a block."""
        x, burst = self.run, self.case.burst
        for i in range(self.bursts):
            begin = i * self.period + QUIET
            for a, b, playing in ((begin - QUIET, begin, None), (begin, begin + burst.samples, burst)):
                yield ResidualBlock(
                    a,
                    x.dt,
                    x.r[a:b],
                    x.beta[a:b],
                    x.u[a:b],
                    x.y[a:b],
                    x.alpha[a:b],
                    playing,
                    f"burst {i}" if playing else "",
                    begin,
                )

    def residuals(self) -> Array:
        """Return the normalised residual of every burst with the quiet stretch before it, shape ``(N, period, p)``."""
        return self.noise.reshape(self.bursts, self.period, -1)


def record(case: RateCase, bursts: int, seed: int) -> Record:
    """Return a record of a healthy machine."""
    source = trials(case.problem, case.burst)
    alpha = np.tile(np.vstack([np.zeros((QUIET, case.burst.inputs)), case.burst.play(case.dt)]), (bursts, 1))
    noise = np.random.default_rng([seed, 8]).normal(size=(len(alpha), len(source.root)))
    return Record(case, noise, simulate_burst(case.problem, alpha, noise @ source.root.T, loop=source.loop), bursts)


def agreement(case: RateCase, name: str, rate: float, shown: Record) -> Agreement:
    """Return how the decisions of a burst detector compare with those of its short route."""
    detector = DESIGNS[name].design(with_rate(case.problem, rate), {})
    state, alarms, refused = detector.start(), np.zeros(shown.bursts, bool), np.zeros(shown.bursts, bool)
    for block in shown.blocks():
        state, found = detector.step(state, block)
        for evidence in found:
            i = evidence.k // shown.period
            alarms[i] |= evidence.detected
            refused[i] |= not evidence.trustworthy
    short = short_route(case, name, rate, shown) & ~refused
    return Agreement(shown.bursts, int(alarms.sum()), int(short.sum()), int((alarms != short).sum()), int(refused.sum()))


def short_route(case: RateCase, name: str, rate: float, shown: Record) -> Array:
    """Return the decisions ``(N,)`` found from the noise alone."""
    whole = shown.residuals()
    inside = np.ascontiguousarray(whole[:, QUIET:])
    if name in (*LINE_DETECTORS, *PUBLISHED):
        e, h = alarm_region(case, name, rate)
        return np.array([bool((e @ coordinates(case, burst) > h).any()) for burst in inside])
    if name in BASELINES:
        found = case.statistic(name, rate)
        h = found.decide(_counted(found, case), case.burst, case.dt)[0].threshold  # type: ignore[attr-defined]
        values = np.abs(inside).max(axis=(1, 2)) if found.peak else np.sum(inside**2, axis=(1, 2))  # type: ignore[attr-defined]
        return np.asarray(values > h)
    if name == "cusum":
        return cusum_alarms(case, inside, rate)
    on, index = loop(case), REGRESSIONS.index(name)
    quiet = QUIET - on.burst
    found_all = [statistics(on, on.sums(np.ascontiguousarray(burst[quiet:])))[REGRESSIONS[index]] for burst in whole]
    return np.array([statistic > threshold(correlation, rate) for statistic, correlation in found_all])


def _counted(found: object, case: RateCase) -> object:
    return replace(found.start(case.burst, case.dt), n=case.burst.samples)  # type: ignore[attr-defined]


def coordinates(case: RateCase, residual: Array) -> Array:
    """Return standardised line coordinates of one burst's normalised residual."""
    basis, (first, last) = Basis(tuple(sorted({line.omega for line in case.burst.lines}))), window(case.burst)
    sums = BasisSums.empty(basis, residual.shape[1]).add(basis, first, case.dt, residual[first:last])
    return np.linalg.solve(np.linalg.cholesky(sums.G), sums.B).ravel()


def passive_agreement(case: RateCase, rate: float, records: int, seed: int) -> Agreement:
    """Return the same for the CUSUM between bursts: first alarms of records of quiet samples, equal to the sample."""
    w, p = watch(case, (rate,)), case.problem.plant.outputs
    n, source = w.settle + 10 * w.span, trials(case.problem, case.burst)
    per_hour = rate / (w.span * case.dt) * 3600
    detector = DESIGNS["passive_cusum"].design(with_rate(case.problem, per_hour=per_hour), {"gate_level": 1e-9})
    rng, alarms, short, differ = np.random.default_rng([seed, 9]), 0, 0, 0
    for _ in range(records):
        e = rng.normal(size=(n, p))
        run = simulate_burst(case.problem, np.zeros((n, case.burst.inputs)), e @ source.root.T, loop=source.loop)
        state, first = detector.start(), -1
        for block in run.blocks(2000):
            state, found = detector.step(state, block)
            first = next((x.k for x in found if x.detected), first) if first < 0 else first
        at = int(passive_alarms(w, e)[0][0])
        at = at + w.settle if at >= 0 else -1
        alarms, short, differ = alarms + (first >= 0), short + (at >= 0), differ + (first != at)
    return Agreement(records, alarms, short, differ, 0)
