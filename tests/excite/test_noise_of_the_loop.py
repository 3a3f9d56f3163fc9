"""The loop's own noise, process noise included, against a simulator that shares no code with the package."""

import numpy as np
import pytest

from afdsvc.api.bursts import Line
from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.statistics.fault_curves import fault_curves
from afdsvc.excite.amplitude_budget import noise_deviations, room
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import simulate_burst
from afdsvc.lti.simulate import simulate
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

MACHINES = {m.name: m for m in machines()}


@pytest.mark.parametrize("name", MACHINES)
def test_deviations_of_outputs_and_inputs(name):
    found, true = noise_deviations(problem_of(MACHINES[name])), MACHINES[name].spread()
    assert found[0] == pytest.approx(true[0], rel=1e-6)
    assert found[1] == pytest.approx(true[1], rel=1e-6)


def test_deviations_with_a_fault():
    machine = MACHINES["process noise large"]
    problem = problem_of(machine)
    run = machine.run(np.random.default_rng(2), np.zeros((100_000, 2)), loss_of(problem, {"s0": -0.5}))
    y, u = noise_deviations(problem, {"s0": -0.5})
    assert y == pytest.approx(run["y"].std(axis=0), rel=0.03)
    assert u == pytest.approx(run["u"].std(axis=0), rel=0.03)


def test_bursts_stay_inside_the_limits_where_process_noise_fills_them():
    machine = MACHINES["process noise large"]
    problem = problem_of(machine, room=8.0)
    burst = default_burst(problem, problem.limits, 1.0)
    assert (room(problem, problem.limits).output < 0.5 * problem.limits.output).all()
    for seed in range(30):
        y = machine.run(np.random.default_rng(seed), alpha_of(burst, machine.dt, 300))["y"]
        assert (np.abs(y) <= problem.limits.output).all()


def test_innovations_drive_the_loop_like_the_two_noises():
    problem = problem_of(MACHINES["unstable"])
    r = np.random.default_rng(3).standard_normal((100_000, 1)) * np.sqrt(problem.covariance)
    run = simulate_burst(problem, np.zeros_like(r), r)
    assert run.r == pytest.approx(r, abs=1e-9)
    assert run.y.std(axis=0) == pytest.approx(MACHINES["unstable"].spread()[0], rel=0.03)


@pytest.mark.parametrize("fault", ["s0", "a0"])
def test_covariance_of_the_lines_in_the_faulty_loop(fault):
    machine = MACHINES["process noise large"]
    problem, lines, n = problem_of(machine), (Line(0, 300.0, 1.0), Line(1, 900.0, 1.0)), 250
    expected = fault_curves(problem, lines).coloured(fault, [-0.6])[1][0]
    run = machine.run(np.random.default_rng(5), np.zeros((n * 2001, 2)), loss_of(problem, {fault: -0.6}))
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    e = r @ np.linalg.inv(np.linalg.cholesky(problem.covariance)).T
    basis = Basis(tuple(line.omega for line in lines))
    z = np.array([project(BasisSums.empty(basis, 2).add(basis, 0, machine.dt, e[k * n : (k + 1) * n]), basis).z.ravel() for k in range(1, 2001)])
    found = z.T @ z / len(z)
    sd = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / len(z))
    assert (np.abs(found - expected) < 5 * sd + 0.02).all()  # leakage between lines of finite length: 0.02
