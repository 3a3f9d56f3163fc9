"""The diagnosis burst: inside the limits, sized for isolation, honest in its notes."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.app.commissioning import commission
from afdsvc.app.commissioning import problem as detection_problem
from afdsvc.app.pipelines import diagnosis_burst
from afdsvc.detect.thresholds.power import required_separation
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.amplitude_budget import costs, noise_deviations
from afdsvc.excite.diagnosis_burst import Aim, default_burst, stated_burst
from afdsvc.excite.expected_detection import burst_detection, steady_samples
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.files.site import parse_site
from afdsvc.plugins.manager import load
from afdsvc.testing.machines import bearing_problem, unstable_problem

CASES = [("proportional", 0), ("proportional", 1100), ("lqg", 0), ("lqg", 1100)]


@pytest.mark.parametrize(("controller", "rpm"), CASES)
def test_all_four_faults_can_be_distinguished_inside_the_limits(controller, rpm):
    problem = bearing_problem(controller, rpm)
    burst = default_burst(problem, problem.limits)
    assert burst.samples * problem.plant.dt == pytest.approx(2.5)
    assert "not_separated" not in burst.notes
    apart = burst_detection(problem, burst).separations(-0.5)
    assert apart.min() > 0.99 * required_separation(0.99, 0.99999)
    _, noise = noise_deviations(problem)
    for fault in (None, *problem.fault_names):
        for severity in (-0.5, -1.0):
            faults = {fault: severity} if fault else {}
            run = simulate_burst(problem, burst.play(problem.plant.dt), np.zeros((burst.samples, 2)), faults)
            assert (np.abs(run.y).max(axis=0) < 2.5).all()  # of 10 um
            assert (np.abs(run.u).max(axis=0) + 5 * noise < problem.limits.input).all()


def test_lines_have_whole_periods_in_the_steady_part_and_differ():
    problem = bearing_problem()
    burst = default_burst(problem, problem.limits)
    periods = [line.omega * steady_samples(burst) * problem.plant.dt / (2 * np.pi) for line in burst.lines]
    assert np.allclose(periods, np.round(periods))
    assert len(set(periods)) == len(burst.lines) == 2
    assert {line.input for line in burst.lines} == {0, 1}


def test_alpha_starts_and_ends_at_rest():
    problem = bearing_problem()
    alpha = default_burst(problem, problem.limits).play(problem.plant.dt)
    assert np.abs(alpha[[0, -1]]).max() < 1e-9
    assert np.abs(np.diff(alpha, axis=0))[[0, -1]].max() < 1e-3 * np.abs(alpha).max()


def test_output_amplitude_is_what_is_asked_for():
    problem = bearing_problem()
    burst = default_burst(problem, problem.limits, output_amplitude=0.4)
    for line in burst.lines:
        assert line.amplitude * costs(problem, [line.omega]).output[0, :, line.input].max() == pytest.approx(0.4)
    assert "not_separated" in burst.notes
    assert "horizontal_actuator from horizontal_sensor" in burst.notes["not_separated"]


def test_noise_deviations_against_a_long_run():
    problem = bearing_problem("lqg")
    y, u = noise_deviations(problem)
    v = np.random.default_rng(1).normal(size=(200_000, 2)) @ np.linalg.cholesky(problem.covariance).T
    run = simulate_burst(problem, np.zeros_like(v), v, loop=faulty_loop(problem, {}))
    assert run.y.std(axis=0) == pytest.approx(y, rel=0.02)
    assert run.u.std(axis=0) == pytest.approx(u, rel=0.02)


def test_a_smaller_loss_needs_more():
    problem = bearing_problem()
    small = default_burst(problem, problem.limits, aim=Aim(severity=-0.25))
    large = default_burst(problem, problem.limits, aim=Aim(severity=-0.5))
    assert float(small.notes["output_amplitude"]) > 1.5 * float(large.notes["output_amplitude"])


def test_limits_are_kept_even_when_they_defeat_the_aim():
    problem = bearing_problem()
    tight = Limits(np.array([10.0, 10]), np.array([10.0, 10]), np.array([0.5, 0.5]))
    burst = default_burst(problem, tight)
    assert np.abs(burst.play(problem.plant.dt)).max() <= 0.5 + 1e-12
    assert "not_separated" in burst.notes


def test_a_one_input_machine_gets_both_lines_on_it():
    problem = unstable_problem()
    loose = replace(problem.limits, output=np.array([50.0]), input=np.array([50.0]), alpha=np.array([50.0]))
    burst = default_burst(problem, loose, seconds=3.0)
    assert [line.input for line in burst.lines] == [0, 0]


def test_no_room_and_nonsense_are_refused_with_reasons():
    problem = bearing_problem()
    full = Limits(np.array([1.0, 1]), np.array([10.0, 10]), np.array([10.0, 10]))
    with pytest.raises(Refused, match="cannot be added"):
        default_burst(problem, full)
    with pytest.raises(BadInput, match="positive numbers"):
        default_burst(problem, problem.limits, seconds=-1.0)
    with pytest.raises(BadInput, match="too few"):
        default_burst(problem, problem.limits, seconds=0.003)


@pytest.mark.parametrize("rpm", [600, 1100, 3000])
def test_lines_keep_away_from_the_orders_of_a_rotor(rpm):
    problem = replace(bearing_problem("lqg"), speed=rpm * np.pi / 30)
    burst = default_burst(problem, problem.limits, 1.0, 0.4)
    steady = steady_samples(burst) * problem.plant.dt
    assert len(burst.lines) == 2
    for line in burst.lines:
        for order in range(1, 5):
            apart = abs(line.omega - order * problem.speed)
            assert apart > 3 * 2 * np.pi / steady
            assert apart > 0.02 * order * problem.speed


def test_a_line_that_sits_on_an_order_is_moved():
    still = bearing_problem("lqg")
    line = default_burst(still, still.limits, 1.0, 0.4).lines[0]
    burst = default_burst(replace(still, speed=line.omega), still.limits, 1.0, 0.4)
    assert min(abs(other.omega / line.omega - 1) for other in burst.lines) > 0.02


def test_one_input_and_one_output_get_two_lines_of_the_power_of_one():
    problem = unstable_problem()
    limits = Limits(np.full(1, 50.0), np.full(1, 50.0), np.full(1, 50.0))
    burst = default_burst(problem, limits, 0.6, 1.5)
    slow, fast = sorted(line.omega for line in burst.lines)
    assert fast > 1.4 * slow
    spent = costs(problem, np.array([line.omega for line in burst.lines])).output[:, 0, 0]
    caused = np.array([line.amplitude for line in burst.lines]) * spent
    assert np.sum(caused**2) == pytest.approx(1.5**2, rel=1e-6)


def test_stated_lines_are_played_as_they_are_or_refused_with_the_limit():
    problem = bearing_problem("proportional")
    burst = stated_burst(problem, problem.limits, 12.0, [Line(0, 62.0, 2.26)])
    assert (burst.lines, burst.samples) == ((Line(0, 62.0, 2.26),), 60_000)
    assert burst.notes["certificate"]
    with pytest.raises(Refused, match="output 'horizontal'"):
        stated_burst(problem, problem.limits, 12.0, [Line(0, 62.0, 9.0)])
    with pytest.raises(BadInput, match="between 0 and 15708"):
        stated_burst(problem, problem.limits, 12.0, [Line(0, 2e4, 0.1)])


def test_a_site_states_its_lines(tmp_path):
    text = 'site = "hall"\n[[machines]]\nid = "bearing"\nplant = "gas_bearing"\nbursts = {lines = [{input = "vertical", rad_s = 62, alpha = 0.5}]}\n'
    machine = commission(parse_site(text, "t").machines[0], load())
    burst = diagnosis_burst(machine)(detection_problem(machine, machine.noise, FalseAlarms()))
    assert burst.lines == (Line(1, 62.0, 0.5),)
    wrong = commission(parse_site(text.replace('"vertical"', '"v"'), "t").machines[0], load())
    with pytest.raises(BadInput, match="expected one of horizontal, vertical"):
        diagnosis_burst(wrong)(detection_problem(wrong, wrong.noise, FalseAlarms()))
