"""Data that must not be judged, simulated on the gas bearing: every burst detector says so instead of deciding."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.detect.features.data_checks import weakest
from afdsvc.errors import BadInput
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import SimulatedBurst, faulty_loop, played, simulate_burst
from afdsvc.lti.simulate import simulate
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem

DESIGNS = {d.name: d for d in afdsvc_detectors()}
BURST = [name for name in DESIGNS if name != "passive_cusum"]
QUIET = 3000


@pytest.fixture(scope="module")
def bearing():
    problem = bearing_problem("lqg")
    return problem, default_burst(problem, problem.limits, 0.8, 1.0)


def white(problem, n, seed=1):
    return np.random.default_rng(seed).normal(size=(n, 2)) @ np.linalg.cholesky(problem.covariance).T


def reported(name, problem, record, burst, alpha=None):
    """What the detector says of the whole run; ``alpha`` is recorded instead of what was played."""
    detector = DESIGNS[name].design(problem, {"deflection": 100.0} if name == "cusum" else {})
    state, found = detector.start(), []
    for block in (record if alpha is None else replace(record, alpha=alpha)).blocks(1000, burst, QUIET):
        state, evidence = detector.step(state, block)
        found += evidence
    return found


def silent(found, words):
    assert found
    assert not any(e.detected for e in found)
    assert not any(e.trustworthy for e in found)
    assert words in found[0].reason


@pytest.mark.parametrize("name", list(DESIGNS))
@pytest.mark.parametrize("wrong", [np.zeros((2, 2)), np.full((2, 2), np.nan)])
def test_a_missing_noise_model_is_refused(name, wrong, bearing):
    with pytest.raises(BadInput, match="state the noise of every output"):
        DESIGNS[name].design(replace(bearing[0], covariance=wrong), {})


@pytest.mark.parametrize("name", BURST)
def test_one_sensor_noisier_than_stated(name, bearing):
    problem, burst = bearing
    alpha = played(burst, 2e-4, QUIET, 20)
    record = simulate_burst(problem, alpha, white(problem, len(alpha)) * np.array([1.0, 1.3]))
    silent(reported(name, problem, record, burst), "times the stated standard deviation")


@pytest.mark.parametrize("name", BURST)
def test_noise_of_another_colour_than_stated(name, bearing):
    problem, burst = bearing
    alpha = played(burst, 2e-4, QUIET, 20)
    v = white(problem, len(alpha) + 1)
    record = simulate_burst(problem, alpha, (v[1:] + 0.4 * v[:-1]) / np.sqrt(1.16))
    silent(reported(name, problem, record, burst), "quiet residual")


@pytest.mark.parametrize("name", BURST)
@pytest.mark.parametrize("fault", [None, "horizontal_actuator"])
def test_a_burst_that_was_recorded_as_played_but_never_reached_the_machine(name, fault, bearing):
    problem, burst = bearing
    alpha = played(burst, 2e-4, QUIET, 20)
    record = simulate_burst(problem, np.zeros_like(alpha), white(problem, len(alpha)), {fault: -0.5} if fault else {})
    silent(reported(name, problem, record, burst, alpha), "excitation is absent from the data")


@pytest.mark.parametrize("name", BURST)
def test_one_of_two_inputs_was_not_played(name, bearing):
    problem, burst = bearing
    alpha = played(burst, 2e-4, QUIET, 20)
    record = simulate_burst(problem, alpha * np.array([1.0, 0.0]), white(problem, len(alpha)))
    silent(reported(name, problem, record, burst, alpha), "excitation is absent from the data")


@pytest.mark.parametrize("fault", ["horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor"])
def test_total_loss_of_a_part_is_no_absent_excitation(fault, bearing):
    problem, burst = bearing
    alpha = played(burst, 2e-4, QUIET, 20)
    record = simulate_burst(problem, alpha, white(problem, len(alpha)), {fault: -1.0})
    (found,) = reported("regression", problem, record, burst)
    assert found.trustworthy, found.reason
    assert found.detected


def test_the_weakest_input_is_that_of_a_simulated_loop(bearing):
    problem, burst = bearing
    lines = tuple(sorted(burst.lines, key=lambda line: line.omega))
    n, fault = 20_000, {"horizontal_sensor": -1.0}
    t = np.arange(n) * 2e-4
    alpha = np.zeros((n, 2))
    for line in lines:
        alpha[:, line.input] += line.amplitude * np.sin(line.omega * t)
    u = simulate_burst(problem, alpha, np.zeros((n, 2)), fault, faulty_loop(problem, fault)).u[n // 2 :]
    basis = np.column_stack([f(line.omega * t[n // 2 :]) for line in lines for f in (np.sin, np.cos)])
    c = np.linalg.lstsq(basis, u, rcond=None)[0]
    amplitudes = [np.linalg.norm(c[2 * k : 2 * k + 2]) for k in range(len(lines))]
    expected = weakest(problem, lines)
    assert (expected <= np.array(amplitudes) * (1 + 1e-6)).all()
    assert (expected > 0).all()


def clipped(problem, alpha, v, limit):
    """The loop with actuators that give no more than ``limit``; the input recorded is what they gave."""
    g, J = problem.plant, problem.interconnection
    x, xk = np.zeros(g.order), np.zeros(J.order)
    y, u = np.zeros_like(v), np.zeros_like(alpha)
    for t in range(len(alpha)):
        y[t] = g.C @ x + v[t]
        ya = np.concatenate([y[t], alpha[t]])
        u[t] = np.clip((J.C @ xk + J.D @ ya)[: g.inputs], -limit, limit)
        x, xk = g.A @ x + g.B @ u[t], J.A @ xk + J.B @ ya
    r, _ = simulate(problem.innovations, np.hstack([y, u]))
    return SimulatedBurst(g.dt, r, y, u, alpha, v)


@pytest.mark.parametrize("name", BURST)
@pytest.mark.parametrize("stated", [True, False])
def test_an_actuator_that_saturates_during_the_burst(name, stated, saturated):
    problem, burst, record, limit = saturated
    limits = replace(problem.limits, input=limit) if stated else None
    silent(reported(name, replace(problem, limits=limits), record, burst), "was saturated for")


@pytest.fixture(scope="module")
def saturated():
    problem = bearing_problem("proportional")
    burst = default_burst(problem, problem.limits, 0.8, 3.0)
    alpha = played(burst, 2e-4, QUIET, 20)
    v = white(problem, len(alpha))
    free = simulate_burst(problem, alpha, v).u
    limit = np.quantile(np.abs(free[QUIET:]), 0.95, axis=0)
    assert (np.abs(free[:QUIET]) < limit).all()  # the loop alone never reaches it
    return problem, burst, clipped(problem, alpha, v, limit), limit
