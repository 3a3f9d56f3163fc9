"""The design says with which burst, or pair of bursts, two faults are distinguished; simulation agrees."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.detect.features.demodulation import Basis, BasisSums, project
from afdsvc.detect.features.regressors import whitener
from afdsvc.detect.isolation import LineData, anything_log_evidence, curve_fit, weights
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.detect.thresholds.power import weight_reached
from afdsvc.errors import Refused
from afdsvc.excite.diagnosis_burst import default_burst, second_burst
from afdsvc.excite.expected_detection import burst_detection
from afdsvc.excite.isolation import NOT_ISOLABLE, isolable_pairs, separation
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.testing.machines import bearing_problem
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

PAIR = ("horizontal_actuator", "horizontal_sensor")


def entry(pairs, a, b):
    return next(p for p in pairs if set(p["faults"]) == {a, b})


def test_a_large_burst_isolates_every_pair_by_itself():
    problem = bearing_problem("lqg")
    pairs = isolable_pairs(problem, default_burst(problem, problem.limits), -0.5)
    assert len(pairs) == 6
    assert {p["isolated_by"] for p in pairs} == {"diagnosis"}
    assert min(p["probability"] for p in pairs) >= 0.99


def test_a_small_burst_needs_a_second_one_for_actuator_and_sensor_of_one_axis():
    problem = bearing_problem("proportional")
    pairs = isolable_pairs(problem, default_burst(problem, problem.limits, output_amplitude=0.3), -0.5)
    reported = entry(pairs, *PAIR)
    assert reported["isolated_by"] == "diagnosis, then isolation"
    assert reported["second_burst"]["lines"]
    assert entry(pairs, "horizontal_actuator", "vertical_sensor")["isolated_by"] == "diagnosis"


def test_what_no_burst_within_the_limits_separates_is_said_beforehand():
    problem = bearing_problem("proportional")
    tight = replace(problem, limits=replace(problem.limits, output=problem.limits.output * 0.29))
    reported = entry(isolable_pairs(tight, default_burst(tight, tight.limits, output_amplitude=0.2), -0.5), *PAIR)
    assert reported["isolated_by"] == NOT_ISOLABLE
    assert reported["probability"] < 0.99
    assert "largest second burst the limits allow" in reported["why"]
    nobody = entry(isolable_pairs(replace(problem, limits=None), default_burst(tight, tight.limits, 2.5, 0.2), -0.5), *PAIR)
    assert nobody["isolated_by"] == NOT_ISOLABLE
    assert "states no limits" in nobody["why"]


def isolated(problem, burst, fault, severity, runs):
    """Share of simulated bursts after which the right fault has a weight of 0.99 among all four and 'none'."""
    lines = tuple(sorted(burst.lines, key=lambda line: line.omega))
    curves, loop, Li = burst_detection(problem, burst).curves, faulty_loop(problem, {fault: severity}), whitener(problem.covariance)
    basis, (first, last), alpha = Basis(tuple(line.omega for line in lines)), window(burst), burst.play(problem.plant.dt)
    root, count = np.linalg.cholesky(problem.output_cov), 0
    for seed in range(runs):
        v = np.random.default_rng(seed).normal(size=(burst.samples, 2)) @ root.T
        r = simulate_burst(problem, alpha, v, loop=loop).r[first:last] @ Li.T
        found = project(BasisSums.empty(basis, 2).add(basis, first, problem.plant.dt, r), basis)
        data = LineData(found.z, found.R, np.zeros((found.z.size, found.z.size)))
        fits = [curve_fit(curves, name, data, (-1.0, 0.0)) for name in curves.names]
        count += weights(fits, anything_log_evidence(found.z))[fault] >= 0.99
    return count / runs


def agrees(found, stated, runs):
    return found == pytest.approx(stated, abs=2.58 * np.sqrt(max(stated * (1 - stated), 1 / runs) / runs))


@pytest.mark.parametrize(
    ("controller", "amplitude", "runs"),
    [("proportional", 0.9, 60), *(pytest.param(c, a, 500, marks=pytest.mark.long) for c in ("lqg", "proportional") for a in (0.8, 1.1))],
)
def test_simulation_agrees_with_the_isolation_stated_for_one_burst(controller, amplitude, runs):
    problem = bearing_problem(controller)
    burst = default_burst(problem, problem.limits, 1.0, amplitude)
    apart = burst_detection(problem, burst).separation(PAIR[0], -0.5, PAIR[1])
    stated = weight_reached(apart, 0.99)
    assert 0.02 < stated < 0.999
    assert agrees(isolated(problem, burst, PAIR[0], -0.5, runs), stated, runs)


@pytest.mark.parametrize(("controller", "runs"), [("proportional", 30), pytest.param("lqg", 400, marks=pytest.mark.long)])
def test_simulation_agrees_with_the_isolation_stated_for_a_second_burst(controller, runs):
    problem = bearing_problem(controller)
    first = default_burst(problem, problem.limits, 1.0, 0.3)
    reported = entry(isolable_pairs(problem, first, -0.5), *PAIR)
    assert reported["isolated_by"] == "diagnosis, then isolation"
    second = second_burst(problem, problem.limits, dict.fromkeys(PAIR, 0.5), -0.5, 1.0)
    assert [(line.input, line.omega) for line in second.lines] == [(x["input"], x["rad_s"]) for x in reported["second_burst"]["lines"]]
    assert reported["separation"] == pytest.approx(separation(burst_detection(problem, second), PAIR, -0.5))
    assert agrees(isolated(problem, second, PAIR[0], -0.5, runs), reported["probability"], runs)


def test_the_second_burst_for_a_pair_is_made_for_all_faults_in_doubt():
    problem = problem_of(next(m for m in machines() if m.name == "order 8, process noise small"))
    burst = second_burst(problem, problem.limits, {"a0": 0.5, "a0+s1": 0.5}, -0.2)
    before, after = (burst_detection(problem, b).separation("s1", -0.2, "a0") for b in (default_burst(problem, problem.limits), burst))
    assert burst.purpose == "isolate"
    assert after > 1.5 * before > 5.0


def test_pairs_that_do_the_same_to_the_loop_are_refused_a_second_burst():
    problem = problem_of(next(m for m in machines() if m.name == "order 8, process noise small"))
    with pytest.raises(Refused, match=r"no burst distinguishes a0\+a1 from s0\+s1"):
        second_burst(problem, problem.limits, {"a0+a1": 0.6, "s0+s1": 0.4}, -0.2)
