"""The iterated regression's statistic where one step is exact: that of the regression on the samples after settling."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.detect.features.regressors import regressors
from afdsvc.detect.statistics.iterated_regression import iterated
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.plugins.manager import load
from afdsvc.testing.machines import bearing_problem
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of
from benchmarks.support.trials import trials


def test_bias_and_spread_of_the_signed_root_are_taken_out():
    problem = bearing_problem("lqg")
    burst, filters = default_burst(problem, problem.limits, 0.5, 0.4), regressors(problem)
    source, settle, dt = trials(problem, burst, filters=filters), filters.settling(1e-3), problem.plant.dt
    statistic = iterated(problem, settle)
    mean, sd = noise_driven(problem).signed_root(burst.samples - settle, burst)
    assert np.abs(mean).max() > 0.05  # of a standard deviation: enough to matter
    for seed in range(4):
        shown = source.samples(source.noise(seed))
        series = shown.series[settle:]
        b, G = (np.einsum("tkp,tkp->k", series[:, 1:], x) for x in (series[:, :1], series[:, 1:]))
        expected = np.max((np.maximum(-b / np.sqrt(G), 0.0) - mean) / sd)
        sums, _ = statistic.step(statistic.start(burst, dt), shown)
        assert statistic.decide(sums, burst, dt)[0].statistic == pytest.approx(expected, abs=0.02)


def test_a_burst_that_is_over_before_the_predictor_has_forgotten_its_start_is_refused():
    machine = next(m for m in machines() if m.name == "integrating")  # forgets in 2077 samples
    problem = problem_of(machine)
    detector = load().get("detectors", "iterated_regression").design(problem, {})
    for samples, refused in ((2000, True), (4000, False)):
        e = judged(machine, problem, detector, Burst("b", 1, samples, 100, (Line(0, 220.0, 5.0),), settle=60), 1, {"a0": -0.3})
        assert e.reason.startswith("the predictor forgets its start in 2077 samples; the burst has 2000") == refused
        assert (e.trustworthy, e.detected) == (not refused, not refused)


def test_losses_of_sensors_are_unbiased_where_process_noise_is_large():
    machine = next(m for m in machines() if m.name == "process noise large")
    problem = problem_of(machine)
    detector = load().get("detectors", "iterated_regression").design(problem, {})
    fault = next(n for n in problem.fault_names if n.startswith("s"))
    errors = []
    for seed in range(8):
        e = judged(machine, problem, detector, Burst("b", 2, 2000, 100, (Line(0, 220.0, 2.0),), settle=60), seed, {fault: -0.3})
        errors.append((e.parts[f"severity.{fault}"] + 0.3) / e.parts[f"sd.{fault}"])
    assert abs(np.mean(errors)) < 2.58 / np.sqrt(len(errors)) + 0.2, errors
