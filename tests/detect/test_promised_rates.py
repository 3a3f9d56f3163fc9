"""Alarm rates: within their 99 per cent Monte Carlo interval of what is promised, down to one in ten thousand bursts."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits
from afdsvc.detect.burst_detector import BurstSamples
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.active_cusum import ActiveCusum
from afdsvc.detect.statistics.matched_filter import MatchedFilter, window
from afdsvc.detect.statistics.regression import regression
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem, with_rate
from benchmarks.support.trials import faulty, tilted, trials

MACHINES = {
    "proportional 0": lambda: bearing_problem("proportional", 0),
    "proportional 1100": lambda: bearing_problem("proportional", 1100),
    "lqg 0": lambda: bearing_problem("lqg", 0),
    "lqg 1100": lambda: bearing_problem("lqg", 1100),
    "unstable": unstable_problem,
    "random": random_problem,
}
STEPS = tuple(float(v) for v in np.linspace(0, -1, 9)[1:])


def statistics(problem):
    filters = regressors(problem)
    return filters, {
        "matched_filter": MatchedFilter(problem, STEPS),
        "fault_curves": MatchedFilter(problem, (), drift=True, likelihood=True),
        "regression": regression(problem, filters),
        "cusum": ActiveCusum(problem),
    }


def short_burst(problem):
    """A burst of a few hundred samples at moderate size, where small-sample effects would show."""
    m, p = problem.plant.inputs, problem.plant.outputs
    limits = problem.limits or Limits(np.full(p, 50.0), np.full(m, 50.0), np.full(m, 50.0))
    loose = replace(limits, output=np.minimum(limits.output, 50.0))
    samples = 2500 if problem.plant.dt < 1e-3 else 600
    return default_burst(problem, loose, samples * problem.plant.dt, 0.4)


def alarmed(statistic, samples, burst, dt):
    """Whether one burst raises an alarm."""
    sums, early = statistic.step(statistic.start(burst, dt), samples)
    if early is not None:
        return True
    if hasattr(statistic, "test"):
        found, threshold = statistic.test(sums, burst)
        return found > threshold
    finding = statistic.decide(sums, burst, dt)[0]
    return finding.statistic > finding.threshold


def rate(name, machine, per_burst, runs, seed=0):
    problem = with_rate(MACHINES[machine](), per_burst=per_burst)
    burst = short_burst(problem)
    filters, known = statistics(problem)
    base = trials(problem, burst, filters=filters)
    return np.mean([alarmed(known[name], base.samples(base.noise(seed + k)), burst, problem.plant.dt) for k in range(runs)])


def rare_rate(name, machine, per_burst, runs, seed=0):
    """Rate and its standard error by importance sampling."""
    problem = with_rate(MACHINES[machine](), per_burst=per_burst)
    burst = short_burst(problem)
    filters, known = statistics(problem)
    weights = []
    if name == "regression":
        noise = noise_driven(problem)
        information = burst.samples * (noise.passive + noise.excited(burst)[0])
        low = np.array([0.9 * bounds[0] for bounds in reachable(problem).values()])
        source = faulty(problem, burst, np.maximum(-3.9 / np.sqrt(information), low), filters)
    else:
        reach = max(low for low, _ in reachable(problem).values())
        steps = [s for s in STEPS[::2] if s > reach] or [0.9 * reach]
        source = tilted(trials(problem, burst, filters=filters), 3.7, steps, window(burst))
    for k in range(runs):
        samples, weight = source.draw(seed + k)
        weights.append(weight * alarmed(known[name], samples, burst, problem.plant.dt))
    return np.mean(weights), np.std(weights) / np.sqrt(runs)


def rare_cusum_rate(machine, per_burst, runs):
    """The same for the CUSUM: waves that set in at a random sample, weighted at the alarm by all the onsets there might be.

    The residual of a healthy machine is the noise itself, so the loop need not be simulated.
    """
    problem = with_rate(MACHINES[machine](), per_burst=per_burst)
    burst, dt = short_burst(problem), problem.plant.dt
    statistic = ActiveCusum(problem)
    start = statistic.start(burst, dt)
    unit, severity = start.plan.cusum.theta, start.plan.cusum.severity
    ordered = sorted(line.omega for line in burst.lines)
    t = np.arange(burst.samples) * dt
    sines = np.stack([f(w * t) for w in ordered for f in (np.sin, np.cos)], axis=1)
    waves = np.einsum("h,hpf,tf->thp", severity, unit, sines)
    first, last = window(burst)
    waves[:first], waves[last:] = 0.0, 0.0
    n, H, p = waves.shape
    rng, weights = np.random.default_rng(11), []
    for _ in range(runs):
        e, h, tau = rng.normal(size=(n, p)), rng.integers(H), rng.integers(n)
        e[tau:] += waves[tau:, h]
        _, found = statistic.step(start, BurstSamples(0, dt, e[:, None], None))
        weight = 0.0
        if found is not None:
            T = int(found.parts["sample"]) + 1
            ratio = np.cumsum(np.einsum("thp,tp->th", waves[:T], e[:T]) - 0.5 * np.sum(waves[:T] ** 2, axis=2), axis=0)
            since = ratio[-1] - np.vstack([np.zeros(H), ratio[:-1]])
            weight = 1 / ((np.exp(since).sum() / H + (n - T)) / n)
        weights.append(weight)
    return np.mean(weights), np.std(weights) / np.sqrt(runs)


@pytest.mark.parametrize(("name", "machine"), [("matched_filter", "proportional 0"), ("cusum", "lqg 0"), ("regression", "lqg 0")])
def test_one_alarm_in_twenty_bursts(name, machine):
    runs = 400
    assert rate(name, machine, 0.05, runs) == pytest.approx(0.05, abs=2.58 * np.sqrt(0.05 * 0.95 / runs))


@pytest.mark.parametrize("name", ["matched_filter", "regression"])
def test_one_alarm_in_ten_thousand_bursts(name):
    found, error = rare_rate(name, "proportional 0", 1e-4, 300)
    assert error < 0.2e-4
    assert found == pytest.approx(1e-4, abs=2.58 * error + 0.03e-4)


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("machine", list(MACHINES))
@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "regression", "cusum"])
@pytest.mark.parametrize("per_burst", [0.1, 0.01])
def test_frequent_alarms_on_every_machine(name, machine, per_burst):
    runs = int(300 / per_burst**0.5)
    error = np.sqrt(per_burst * (1 - per_burst) / runs)
    assert rate(name, machine, per_burst, runs) == pytest.approx(per_burst, abs=2.58 * error)


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("machine", list(MACHINES))
@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "regression"])
@pytest.mark.parametrize("per_burst", [1e-3, 1e-4])
def test_rare_alarms_by_importance_sampling(name, machine, per_burst):
    found, error = rare_rate(name, machine, per_burst, 1500)
    assert error < 0.15 * per_burst
    assert found == pytest.approx(per_burst, abs=2.58 * error + 0.02 * per_burst)


def test_rare_alarms_of_the_cusum():
    found, error = rare_cusum_rate("proportional 0", 1e-4, 1500)
    assert error < 0.12e-4
    assert found == pytest.approx(1e-4, abs=2.58 * error + 0.05e-4)


@pytest.mark.parametrize("seconds", [0.1, 0.34, 0.6, 1.1])
def test_the_boundary_of_the_cusum_counts_every_block_of_the_burst(seconds):
    """Blocks beyond those the boundary was computed for would raise more alarms than promised."""
    problem = unstable_problem()
    burst = default_burst(problem, Limits(np.array([50.0]), np.array([50.0]), np.array([50.0])), seconds, 0.4)
    plan = ActiveCusum(problem).plan(burst, problem.plant.dt)
    first, last = window(burst)
    assert len(plan.waves) == (last - first) // plan.cusum.block > 0


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("machine", list(MACHINES))
@pytest.mark.parametrize("per_burst", [1e-2, 1e-3, 1e-4])
def test_rare_alarms_of_the_cusum_on_every_machine(machine, per_burst):
    found, error = rare_cusum_rate(machine, per_burst, 10_000)
    assert found == pytest.approx(per_burst, abs=2.58 * error + 0.05 * per_burst)
