"""The binding function of a regression: against simulated machines, and severities without bias where regressors are of first order."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.statistics.binding_function import BindingFunction, products_of_noise
from afdsvc.detect.uncertain_parameters import uncertain_entries
from afdsvc.lti.simulate import simulate
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

MACHINES = {m.name: m for m in machines()}
CASES = [("process noise large", "s1", -0.3), ("integrating", "s0", -0.2), ("unstable", "s0", -0.06), ("tiny units", "s0", -0.3)]


def burst_of(machine, samples):
    size = 2 * float(machine.spread()[1].max())
    lines = tuple(Line(i, w + 70.0 * i, size) for i in range(machine.shape[1]) for w in (220.0, 610.0))
    return Burst("b", machine.shape[1], samples, samples // 20, lines, settle=100)


@pytest.mark.parametrize(("name", "fault", "severity"), CASES)
def test_the_mean_of_a_long_regression(name, fault, severity):
    machine, problem = MACHINES[name], problem_of(MACHINES[name])
    burst, filters, i = burst_of(machine, 40_000), regressors(problem), problem.fault_names.index(fault)
    run = machine.run(np.random.default_rng(1), alpha_of(burst, machine.dt, 0), loss_of(problem, {fault: severity}))
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    series = filters.step(filters.start(), r, run["y"], run["u"])[1]
    e, psi = series[:, 0], series[:, 1 + i]
    found, sd = np.sum(psi * e) / np.sum(psi**2), np.sum(psi**2) ** -0.5
    assert BindingFunction(problem, fault, burst)(severity) == pytest.approx(found, abs=5 * sd)


@pytest.mark.parametrize("fault", ["a0", "s0"])
def test_the_mean_of_a_long_regression_on_noise_where_the_plant_is_another(fault):
    machine, problem, rng = MACHINES["unstable"], problem_of(MACHINES["unstable"]), np.random.default_rng(2)
    pulled = uncertain_entries(problem.plant, {"A": 0.004 * np.abs(machine.A)}, machine.dt)
    run = machine.run(rng, np.zeros((200_000, machine.shape[1])), plant=(machine.A + 0.004 * np.abs(machine.A), machine.B))
    filters, i = regressors(problem), problem.fault_names.index(fault)
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    series = filters.step(filters.start(), r, run["y"], run["u"])[1]
    e, psi = series[:, 0], series[:, 1 + i]
    score, information = products_of_noise(problem, fault, pulled, dict.fromkeys(pulled.fault_names, 1.0))
    sd = np.sum(psi**2) ** -0.5
    assert information == pytest.approx(np.sum(psi**2) / len(psi), rel=0.05)
    assert abs(score / information) > 10 * sd
    assert score / information == pytest.approx(np.sum(psi * e) / np.sum(psi**2), abs=5 * sd)


@pytest.mark.parametrize(("name", "fault", "severity"), CASES)
def test_slope_at_health_and_inverse(name, fault, severity):
    m = BindingFunction(problem_of(MACHINES[name]), fault, burst_of(MACHINES[name], 2000))
    assert m(0.0) == pytest.approx(0.0, abs=1e-9)
    assert m.spread(0.0) == pytest.approx(1.0, abs=1e-3)
    assert (m(1e-4) - m(-1e-4)) / 2e-4 == pytest.approx(1.0, abs=1e-3)
    found, slope = m.inverse(m(severity))
    assert found == pytest.approx(severity, abs=1e-3)
    assert slope == pytest.approx((m(severity + 1e-3) - m(severity - 1e-3)) / 2e-3, rel=0.05)


def test_severities_of_first_order_faults_lie_in_their_intervals():
    machine, problem = MACHINES["process noise large"], problem_of(MACHINES["process noise large"], FalseAlarms(1e-2))
    detector, found = load().get("detectors", "regression").design(problem, {}), []
    for seed in range(80):
        e = judged(machine, problem, detector, burst_of(machine, 2000), seed, {"s1": -0.3})
        found += [e.severity] if e.fault == "s1" else []
    assert len(found) >= 60
    assert sum(s.low <= -0.3 <= s.high for s in found) >= len(found) - 9
    assert np.std([s.value for s in found]) == pytest.approx(np.mean([s.sd for s in found]), rel=0.15)
    assert np.mean([s.value for s in found]) == pytest.approx(-0.3, abs=3 * found[0].sd / len(found) ** 0.5)
