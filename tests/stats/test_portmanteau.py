"""The tests say "something is left" as often as they claim when nothing is, and nearly always when something is."""

import numpy as np
import pytest
from scipy import signal, stats

from afdsvc.errors import BadInput
from afdsvc.stats.portmanteau import portmanteau_test, residual_tests

RUNS = 200


def test_p_values_are_uniform_when_nothing_is_left():
    """Kolmogorov-Smirnov at 0.1 % for each of three statistics; coloured residuals and inputs for the correlations."""
    rng = np.random.default_rng(3)
    white, independent, feedback = [], [], []
    mixing = np.array([[1.0, 0.4], [0.0, 2.0]])
    for _ in range(RUNS):
        u = signal.lfilter([1], [1, -0.9], rng.standard_normal((3000, 2)), axis=0)
        e = signal.lfilter([1], [1, -1.2, 0.6], rng.standard_normal((3000, 2)), axis=0)
        found = residual_tests(e, u)
        independent.append(found.p_independent[0, 1])
        feedback.append(found.p_feedback[1, 0])
        white.append(portmanteau_test(rng.standard_normal((3000, 2)) @ mixing))
    for p_values in (white, independent, feedback):
        assert stats.kstest(p_values, "uniform").pvalue > 1e-3


def test_one_output_is_the_ljung_box_statistic_up_to_its_small_sample_factor():
    rng = np.random.default_rng(4)
    e = rng.standard_normal(800)
    r = [(e[k:] - e.mean()) @ (e[: 800 - k] - e.mean()) / ((e - e.mean()) ** 2).sum() for k in range(1, 11)]
    hosking = 800**2 * sum(x**2 / (800 - k) for k, x in enumerate(r, 1))
    assert portmanteau_test(e[:, None], 10) == pytest.approx(stats.chi2.sf(hosking, 10), rel=1e-9)


def test_a_missed_mode_a_missed_input_and_feedback_are_each_seen_where_they_belong():
    rng = np.random.default_rng(5)
    u, e = rng.standard_normal((4000, 1)), rng.standard_normal((4000, 1))
    assert portmanteau_test(signal.lfilter([1], [1, -0.2], e, axis=0)) < 1e-6
    missed = residual_tests(e + 0.2 * np.roll(u, 3, axis=0), u)
    assert missed.p_independent[0, 0] < 1e-4 < missed.p_feedback[0, 0]
    assert abs(missed.crosscorrelation[25 + 3, 0, 0]) > missed.cross_band[0, 0]
    answered = residual_tests(e, u + 0.2 * np.roll(e, 3, axis=0))
    assert answered.p_feedback[0, 0] < 1e-4 < answered.p_independent[0, 0]


def test_bands_hold_19_of_20_correlations():
    rng = np.random.default_rng(6)
    found = residual_tests(rng.standard_normal((5000, 3)), rng.standard_normal((5000, 2)), 100)
    inside = np.abs(found.autocorrelation[1:]) < found.band
    crossed = np.abs(found.crosscorrelation) < found.cross_band
    assert 0.91 < inside.mean() < 0.98
    assert 0.93 < crossed.mean() < 0.97


def test_noiseless_residuals_pass_and_short_ones_are_named():
    assert portmanteau_test(np.zeros((100, 2))) == 1.0
    with pytest.raises(BadInput, match="50 residuals for 25 lags"):
        residual_tests(np.zeros((50, 1)), np.zeros((50, 1)))
