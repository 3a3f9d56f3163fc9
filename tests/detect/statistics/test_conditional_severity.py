"""The law of a severity given detection: against scipy's truncated normal, and coverage counted on drawn estimates."""

import numpy as np
import pytest
from scipy.stats import binom, norm, truncnorm

from afdsvc.detect.statistics.conditional_severity import log_truncated_cdf, negligible_margin, severity_at

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


def test_difference_at_the_negligible_margin():
    a, sd = negligible_margin(0.1), 0.02
    assert severity_at(0.5, -0.3, sd, -0.3 + a * sd) - -0.3 == pytest.approx(0.1 * sd, rel=1e-6)
