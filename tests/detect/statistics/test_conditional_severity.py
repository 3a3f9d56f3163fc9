"""The law of a severity given detection: against scipy's truncated normal, and coverage counted on drawn estimates."""

import numpy as np
import pytest
from scipy.stats import binom, norm, truncnorm

from afdsvc.api.evidence import Severity
from afdsvc.detect.burst_detector import BurstSamples
from afdsvc.detect.isolation import Fit, limited
from afdsvc.detect.statistics.conditional_severity import given_detection, log_truncated_cdf, severity_at
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.expected_detection import expected_detection
from afdsvc.excite.simulated_burst import faulty_loop, simulate_burst
from afdsvc.plugins.manager import load
from afdsvc.testing.machines import bearing_problem, with_rate

WIDE = (-50.0, 50.0)


@pytest.mark.parametrize("severity", [-0.3, -0.08, -0.02, 0.0])
def test_distribution_function_is_that_of_scipy(severity):
    sd, cut = 0.02, -0.07
    for estimate in (-0.071, -0.09, -0.2):
        expected = truncnorm.logcdf(estimate, -np.inf, (cut - severity) / sd, loc=severity, scale=sd)
        assert log_truncated_cdf(estimate, severity, sd, cut) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("severity", [-0.02, -0.05, -0.1])
def test_median_and_coverage_given_detection(severity):
    """4000 detected estimates per severity; the counts stay in the central 99.9 % of their binomial laws."""
    sd, cut, n = 0.03, -0.08, 4000
    u = np.random.default_rng(1).uniform(size=n)
    x = severity + sd * norm.ppf(u * norm.cdf((cut - severity) / sd))  # inverse of the truncated distribution function
    ends = np.array([[severity_at(p, v, sd, cut, WIDE) for p in (0.975, 0.5, 0.025)] for v in x])
    inside = int(((ends[:, 0] <= severity) & (severity <= ends[:, 2])).sum())
    below = int((ends[:, 1] < severity).sum())
    assert binom.ppf(0.0005, n, 0.95) <= inside <= binom.ppf(0.9995, n, 0.95)
    assert binom.ppf(0.0005, n, 0.5) <= below <= binom.ppf(0.9995, n, 0.5)


def test_without_a_threshold_it_is_the_plain_interval():
    found = [severity_at(p, -0.3, 0.02, 5.0) for p in (0.975, 0.5, 0.025)]
    assert found == pytest.approx([-0.3 - 0.02 * norm.ppf(0.975), -0.3, -0.3 + 0.02 * norm.ppf(0.975)], abs=1e-9)


def test_bounds_hold_an_estimate_at_the_threshold():
    assert severity_at(0.5, -0.08, 0.02, -0.08) == 0.0
    assert severity_at(0.5, -3.0, 0.02, -0.08) == -1.0


def test_far_from_the_limit_the_plain_estimate_is_reported():
    fit = Fit("pump", -0.3, 0.02, 0.0, 0.0, limit=-0.3 + 7 * 0.02)
    assert given_detection(fit, (-1.0, 0.0)) == Severity(-0.3, 0.02, pytest.approx(-0.3392, abs=1e-4), pytest.approx(-0.2608, abs=1e-4))


def test_no_interval_is_given_where_the_error_of_a_linearisation_counts():
    known, unknown = (given_detection(Fit("pump", -0.3, 0.02, 0.0, 0.0, limit=-0.2, bias=bias), (-1.0, 0.0)) for bias in (0.001, 0.01))
    assert None not in (known.low, known.high)
    assert (unknown.low, unknown.high) == (None, None)
    assert (unknown.value, unknown.sd) == (known.value, known.sd)


def test_near_the_limit_the_estimate_moves_towards_health():
    near = given_detection(Fit("pump", -0.3, 0.02, 0.0, 0.0, limit=-0.29), (-1.0, 0.0))
    assert near.value == severity_at(0.5, -0.3, 0.02, -0.29) > -0.3
    assert near.low > -0.3392
    assert near.high - near.value > 0.0392
    assert near.sd >= 0.02


def test_the_limit_is_where_the_last_comparison_falls_below_its_threshold():
    fit = Fit("pump", -0.3, 0.02, 0.0, 0.0)
    assert limited(fit, np.array([1.0, 2.0, -3.0]), np.array([-50.0, -40.0, 10.0])).limit == pytest.approx(-0.25)
    assert limited(fit, np.array([1.0, 2.0]), np.array([-50.0, 0.0])).limit == np.inf  # the second stays above whatever the severity


@pytest.mark.parametrize("detector", ["regression", "matched_filter", "fault_curves", "iterated_regression"])
def test_no_burst_is_detected_beyond_the_limit_it_states(detector):
    """The signals of a detected burst with as much of the fault's wave taken out as its limit says: the statistic meets its threshold."""
    problem = with_rate(bearing_problem("proportional"), per_burst=0.01)
    burst = default_burst(problem, problem.limits, 0.5, 0.8)
    made = load().get("detectors", detector).design(problem, {})
    statistic, quiet, dt = made.statistic, 500, problem.plant.dt
    alpha = np.vstack([np.zeros((quiet, 2)), burst.play(dt)])
    noise = np.random.default_rng(3).normal(size=(len(alpha), 2)) @ np.linalg.cholesky(problem.output_cov).T

    def judged(severity):
        record = simulate_burst(problem, alpha, noise, loop=faulty_loop(problem, {"vertical_actuator": severity}))
        filters = made.front.filters
        state, sums = filters.start(), statistic.start(burst, dt)
        for block in record.blocks(quiet, burst, quiet):
            state, series = filters.step(state, block.r, block.y, block.u)
            if block.burst:
                sums, _ = statistic.step(sums, BurstSamples(block.k0 - quiet, dt, series, block))
        (found,) = statistic.decide(sums, burst, dt)
        return found, next(f for f in found.fits if f.fault == "vertical_actuator")

    smallest = expected_detection(problem, burst.lines, burst.samples).deviation("vertical_actuator", -0.05)
    found, fit = judged(-6 * smallest)
    assert found.statistic > found.threshold
    assert fit.limit > fit.severity
    at, _ = judged(-6 * smallest + fit.limit - fit.severity)
    assert at.statistic == pytest.approx(at.threshold, abs=0.25)
