"""Efficiency, the linear programme over lines, crest factors, the shortest burst: against published and computed
limits.
"""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits, Line
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.detect.thresholds.power import required_deflection, required_separation
from afdsvc.errors import BadInput, Refused
from afdsvc.excite.diagnosis_burst import second_burst
from afdsvc.excite.efficiency import efficiency, samples_for
from afdsvc.excite.expected_detection import burst_detection, expected_detection, steady_samples
from afdsvc.excite.multisine import Wish, _waves, low_crest, multisine, peak, shortest
from afdsvc.excite.power_allocation import allocate, candidates
from afdsvc.testing.machines import bearing_problem, unstable_problem

DT = 2e-4
GRID = np.linspace(1, 6000, 602)


def test_published_efficiencies_of_the_horizontal_pair():
    # gas bearing at rest, k = 0.2, half a loss of the horizontal actuator, alpha_h to r_h (thesis 5.4, recomputed)
    found = efficiency(bearing_problem("proportional"), [1, 62, 125, 1340, 5000], -0.5)
    assert found.pairs[0, :, 0, 0] == pytest.approx([0.34107, 0.34246, 0.34640, 0.70422, 0.49953], abs=2e-5)
    assert found.pairs[1, 1, 0, 0] == pytest.approx(0.000105, abs=1e-6)


def test_a_sensor_never_shows_in_the_other_axis():
    found = efficiency(bearing_problem("proportional"), GRID, -0.5)
    vertical_sensor = found.faults.index("vertical_sensor")
    assert (found.pairs[vertical_sensor, :, 0, 0] < 1e-12).all()
    assert (found.pairs[vertical_sensor, :, 1, 0] > 1e-3).all()


def test_best_single_frequency_of_the_unstable_plant():
    # publication P4: 125 rad/s is best up to 125 rad/s; without that bound it is 466 rad/s
    problem = unstable_problem()
    sigma = np.sqrt(problem.covariance[0, 0])
    low = efficiency(problem, np.linspace(10, 125, 116), -0.1)
    assert low.best_single()[0] == pytest.approx(125)
    assert low.best_single()[2] * sigma == pytest.approx(0.0358, abs=2e-4)
    free = efficiency(problem, np.linspace(10, 3000, 2991), -0.1).best_single()
    assert free[0] == pytest.approx(467, abs=3)
    assert free[2] * sigma == pytest.approx(0.0751, abs=1e-4)


@pytest.mark.parametrize(("controller", "single", "mixture"), [("proportional", 9640, 47.53), ("lqg", 9418, 46.39)])
def test_two_lines_reach_the_computed_limit_where_one_needs_hours(controller, single, mixture):
    # all four faults at -10 %, P_D 0.99 at 1e-6, 0.1 um at the output
    problem = bearing_problem(controller)
    alone = efficiency(problem, GRID, -0.1).best_single()[2]
    assert samples_for(alone, 0.1, 1e-6, 0.99) * DT == pytest.approx(single, rel=2e-3)
    found = candidates(problem, GRID, -0.1)
    wanted = np.concatenate([np.full(4, required_deflection(1e-6, 0.99)), np.zeros(len(found.pairs))])
    split = allocate(found, wanted, [(found.output.sum(axis=0), 0.1**2 / 2)])
    assert split.samples * DT == pytest.approx(mixture, rel=1e-3)
    assert {line.input for line in split.lines} == {0, 1}
    assert split.slack.min() == pytest.approx(1.0)
    assert shortest(problem, Wish(-0.1, 1.0, 0.99, 1e-6)).samples * DT < 0.011 * mixture  # a hundredth at ten times as much


def test_best_mixture_of_the_unstable_plant():
    problem = unstable_problem()
    found = candidates(problem, np.concatenate([[0.1], np.arange(2.0, 3000, 2)]), -0.1)
    split = allocate(found, np.array([1.0, 1.0, 0, 0]), [(found.output.sum(axis=0), 0.5)])
    efficiency_ = np.sqrt(2 / split.samples * problem.covariance[0, 0])
    assert efficiency_ == pytest.approx(0.1103, abs=2e-4)
    assert sorted(line.omega for line in split.lines) == pytest.approx([0.1, 1387], abs=5)


def test_allocation_is_optimal_by_its_dual():
    # complementary slackness: no single candidate improves the worst wish at the optimum's shadow prices
    problem = bearing_problem()
    found = candidates(problem, GRID[::6], -0.2)
    wanted = np.concatenate([np.full(4, 5.0), np.full(len(found.pairs), 9.0)])
    best = allocate(found, wanted, [(found.output.sum(axis=0), 0.5)]).samples
    rng = np.random.default_rng(1)
    gains = np.vstack([found.deflection, found.separation]) / wanted[:, None] ** 2
    for _ in range(500):
        x = rng.exponential(size=gains.shape[1]) ** 4
        x *= 0.5 / (found.output.sum(axis=0) @ x)
        assert 1 / (gains @ x).min() >= best * (1 - 1e-9)


def test_a_wish_no_line_can_serve_is_refused():
    problem = bearing_problem()
    found = candidates(problem, [500.0], -0.2)
    dead = replace(found, deflection=np.where(np.arange(4)[:, None] == 2, 0.0, found.deflection))
    with pytest.raises(Refused, match=r"input shows \[2\]"):
        allocate(dead, np.concatenate([np.ones(4), np.zeros(12)]), [(found.output.sum(axis=0), 1.0)])


def test_phases_lower_the_peak_of_many_lines():
    seconds = 0.5
    lines = tuple(Line(0, 2 * np.pi * k / seconds, 1.0) for k in range(5, 25))
    responses = np.ones((20, 1), complex)
    low = low_crest(lines, responses, seconds, np.ones(1))
    waves = _waves(lines, responses, seconds)
    crest = peak(waves, np.array([line.phase for line in low])) / np.sqrt(10)
    assert crest < 1.75  # in phase 5.2; Schroeder's phases reach 1.9 here, random ones about 3
    assert [(line.omega, line.amplitude) for line in low] == [(line.omega, line.amplitude) for line in lines]


def test_shortest_burst_for_ten_per_cent_below_a_micrometre():
    problem = bearing_problem("lqg")
    burst = multisine(problem, problem.limits, Wish(-0.1, 0.9, 0.99, 1e-3))
    assert burst.samples * DT <= 2.5
    seen = burst_detection(problem, burst)
    threshold = seen.threshold(1e-3)
    for fault in problem.fault_names:
        assert seen.detection(fault, -0.1, threshold) > 0.989
    response = loop_response(problem, [line.omega for line in burst.lines]).healthy()
    rms = sum(
        0.5 * line.amplitude**2 * np.sum(np.abs(response.y[0, k, :, line.input]) ** 2) for k, line in enumerate(burst.lines)
    )
    assert np.sqrt(2 * rms) == pytest.approx(0.9, rel=0.05)


def test_telling_apart_costs_more_than_detecting():
    problem = bearing_problem("lqg")
    detect, apart = (shortest(problem, Wish(-0.5, 2.0, distinguish=t)).samples for t in (False, True))
    assert apart > 5 * detect


def test_a_burst_longer_than_allowed_is_refused_with_its_length():
    problem = bearing_problem("lqg")
    with pytest.raises(Refused, match=r"s are needed .* at most 14 s are allowed"):
        multisine(problem, problem.limits, Wish(-0.02, 0.1, 0.99, 1e-6))
    with pytest.raises(BadInput, match="nonzero"):
        shortest(problem, Wish(0.0, 1.0))
    with pytest.raises(Refused, match="may reach"):
        multisine(problem, Limits(np.full(2, 3.0), np.full(2, 10.0), np.full(2, 100.0)), Wish(-0.1, 4.0))


def test_second_burst_separates_the_two_suspects_better_than_the_first():
    problem = bearing_problem("proportional")
    limits = problem.limits
    weights = {"horizontal_actuator": 0.6, "horizontal_sensor": 0.39, "vertical_actuator": 0.01, "none_of_these": 0.0}
    burst = second_burst(problem, limits, weights, -0.3)
    assert burst.purpose == "isolate"
    first = expected_detection(problem, [Line(0, 62.0, 1.0)], steady_samples(burst))
    per_um = lambda seen, b: seen.separation("horizontal_actuator", -0.3, "horizontal_sensor") / b  # noqa: E731
    assert per_um(burst_detection(problem, burst), float(burst.notes["output_amplitude"])) > 2 * per_um(first, 2.9)
    reached = burst_detection(problem, burst).separation("horizontal_actuator", -0.3, "horizontal_sensor")
    assert reached > 0.99 * required_separation(0.99, 0.99999)
    with pytest.raises(BadInput, match="two faults to distinguish"):
        second_burst(problem, limits, {"horizontal_actuator": 1.0}, -0.3)


def test_published_detection_probabilities_of_the_unstable_plant():
    # publication P4: N = 200, alpha of amplitude 0.1 at 125 rad/s, 1e-4, theta = -0.1; Monte Carlo .9983 and .0082
    problem = unstable_problem()
    seen = expected_detection(problem, [Line(0, 125.0, 0.1)], 200)
    h = 3.7190165
    assert [seen.deflection(f, -0.1) for f in ("b1", "b2")] == pytest.approx([7.543, 1.5765], abs=2e-3)
    assert seen.detection("b1", -0.1, h) == pytest.approx(0.99825, abs=2e-4)
    assert seen.detection("b2", -0.1, h) == pytest.approx(0.00847, abs=2e-4)
