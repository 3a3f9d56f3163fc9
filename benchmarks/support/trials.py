"""Many bursts of one machine, played on paper and shown to bare statistics: for alarm rates and powers by simulation.

Rare alarms are counted by importance sampling: a wave is added to the noise so that alarms are common, and every run is
weighted by the likelihood ratio of the noise it really used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstSamples
from afdsvc.detect.features.regressors import Regressors, regressors
from afdsvc.excite.simulated_burst import SimulatedBurst, faulty_loop, played, simulate_burst
from afdsvc.lti.lft import star
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.whitening import innovations
from benchmarks.support.templates import templates


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """One burst under one condition; ``before`` quiet samples let filters settle.

    The loop is driven by its own innovations (which have the law of the output noise filtered by the predictor), so the
    residual of a healthy machine is the noise drawn, also for an unstable plant. ``own`` recovers the innovations of the
    machine that makes the data from its ``[y; u]``.
    """

    problem: DetectionProblem
    burst: Burst
    filters: Regressors
    loop: StateSpace
    alpha: Array
    before: int
    root: Array
    own: StateSpace

    def noise(self, seed: int) -> Array:
        """Return standard normal noise, shape ``(before + samples, p)``."""
        return np.random.default_rng(seed).normal(size=(len(self.alpha), self.problem.plant.outputs))

    def samples(self, noise: Array) -> BurstSamples:
        """Return what a burst statistic is shown when the normalised noise was this."""
        return self.whole(noise)[0]

    def whole(self, noise: Array) -> tuple[BurstSamples, Array, SimulatedBurst]:
        """Return the samples of the burst, then residual and regressors and the record with the quiet samples before."""
        run = simulate_burst(self.problem, self.alpha, noise @ self.root.T, loop=self.loop)
        _, series = self.filters.step(self.filters.start(), run.r, run.y, run.u)
        block = next(b for b in run.blocks(len(run), self.burst, self.before) if b.burst is not None)
        return BurstSamples(0, self.problem.plant.dt, series[self.before :], block), series, run

    def log_density(self, run: SimulatedBurst) -> float:
        """Return the log density of a record under this machine, up to a constant that all machines share."""
        e, _ = simulate(self.own, np.hstack([run.y, run.u]))
        white = np.linalg.solve(self.root, e.T)
        return float(-0.5 * np.sum(white**2) - len(e) * np.sum(np.log(np.diag(self.root))))


def trials(
    problem: DetectionProblem, burst: Burst, severities: Mapping[str, float] | None = None, before: int | None = None,
    truth: DetectionProblem | None = None, filters: Regressors | None = None,
) -> Trials:
    """Return trials of a burst; ``truth`` is the machine that makes the data when it is not the one that is believed."""
    filters = regressors(problem) if filters is None else filters
    before = filters.settling(1e-3) if before is None else before
    loop, root, own = innovations_loop(truth or problem, severities or {})
    return Trials(problem, burst, filters, loop, played(burst, problem.plant.dt, before), before, root, own)


def innovations_loop(problem: DetectionProblem, severities: Mapping[str, float]) -> tuple[StateSpace, Array, StateSpace]:
    """Return the loop from ``[e, alpha]`` to ``[u, y - e, beta]``, a square root of the covariance of the innovations e, and
    the filter from ``[y; u]`` back to them.

    Raises `BadInput` when the faults make the loop unstable.
    """
    faulty_loop(problem, severities)  # says so when the loop is lost
    g = problem.augmented.close(severities)
    n, m, p = g.order, g.inputs, g.outputs
    cov = problem.covariance if problem.output_cov is None else problem.output_cov
    found = innovations(g, cov, problem.process_cov)
    B = np.hstack([found.gain, g.B])
    C = np.vstack([np.zeros((m, n)), g.C, g.C])
    D = np.block([[np.zeros((m, p)), np.eye(m)], [np.zeros((p, p)), g.D], [np.eye(p), g.D]])
    loop = star(StateSpace(g.A, B, C, D, g.dt), problem.interconnection, p, m)
    return loop, np.asarray(np.linalg.cholesky(found.covariance)), found.filter


@dataclass(frozen=True, slots=True, eq=False)
class Tilted:
    """Noise pushed towards an alarm: by the wave of a fault drawn at random, ``length`` standard deviations long."""

    trials: Trials
    waves: Array
    length: float

    def draw(self, seed: int) -> tuple[BurstSamples, float]:
        """Return samples and their weight, the density of plain noise over that of the mixture used."""
        rng = np.random.default_rng(seed)
        e = rng.normal(size=(self.trials.before + self.waves.shape[0], self.waves.shape[2]))
        pushed = self.waves[:, int(rng.integers(self.waves.shape[1]))]
        e[self.trials.before :] += self.length * pushed
        along = np.einsum("tkp,tp->k", self.waves, e[self.trials.before :])
        ratio = np.mean(np.exp(self.length * along - self.length**2 / 2))
        return self.trials.samples(e), float(1 / ratio)


def tilted(
    base: Trials, length: float, severities: Sequence[float] = (-0.3,), span: tuple[int, int] | None = None
) -> Tilted:
    """Return trials tilted along every fault's wave at every severity, the waves of unit energy within ``span``."""
    problem, alpha = base.problem, base.burst.play(base.problem.plant.dt)
    found = [templates(problem, alpha, np.full(len(problem.fault_names), s)).waves for s in severities]
    waves = np.concatenate(found, axis=1)
    first, last = span or (0, len(alpha))
    waves[:first], waves[last:] = 0.0, 0.0
    return Tilted(base, waves / np.linalg.norm(waves, axis=(0, 2))[None, :, None], length)


@dataclass(frozen=True, slots=True, eq=False)
class Faulty:
    """Runs of faulty machines, weighted back to the healthy one.

    The log likelihood ratio of a run is that of the innovations of either machine; where the regression on psi is exact it
    is ``theta b - theta^2 G / 2`` over all samples, noise-driven part included.
    """

    machines: tuple[Trials, ...]
    severities: Array
    healthy: Trials

    def draw(self, seed: int) -> tuple[BurstSamples, float]:
        """Return samples and their weight, the likelihood of the healthy machine over that of the mixture."""
        rng = np.random.default_rng(seed)
        machine = self.machines[int(rng.integers(len(self.machines)))]
        samples, series, run = machine.whole(rng.normal(size=(len(machine.alpha), series_width(machine))))
        if not all(self.healthy.filters.exact):
            healthy = self.healthy.log_density(run)
            return samples, float(1 / np.mean([np.exp(m.log_density(run) - healthy) for m in self.machines]))
        b = np.einsum("tkp,tp->k", series[:, 1:], series[:, 0])
        G = np.einsum("tkp,tkp->k", series[:, 1:], series[:, 1:])
        return samples, float(1 / np.mean(np.exp(self.severities * b - self.severities**2 * G / 2)))


def series_width(machine: Trials) -> int:
    """Return the number of outputs."""
    return machine.problem.plant.outputs


def faulty(problem: DetectionProblem, burst: Burst, severities: Array, filters: Regressors) -> Faulty:
    """Return runs of machines each with one fault, of the given severity."""
    pairs = zip(problem.fault_names, severities, strict=True)
    machines = tuple(trials(problem, burst, {n: float(s)}, filters=filters) for n, s in pairs)
    return Faulty(machines, np.asarray(severities, dtype=float), trials(problem, burst, filters=filters))
