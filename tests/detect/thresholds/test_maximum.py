"""Thresholds of the maximum over a set of matched filters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

from afdsvc.detect.thresholds import maximum
from afdsvc.errors import BadInput


def phases(*degrees):
    a = np.radians(degrees)
    return np.c_[np.cos(a), np.sin(a)]


# Thresholds at P_FA = 2e-5 for the phase sets printed in the thesis' publications P4 and P5 (computed independently).
@pytest.mark.parametrize(
    ("degrees", "h"),
    [((48.4, 306), 4.264891), ((0, 48.4, 306), 4.349990), ((93, 89, 94, 0), 4.281630), ((125, 269, 0, 93), 4.406841)],
)
def test_published_phase_sets(degrees, h):
    assert maximum.maximum_threshold(phases(*degrees), 2e-5) == pytest.approx(h, abs=2e-5)


def test_one_direction_is_the_normal_tail_and_two_opposite_ones_twice_that():
    assert maximum.exceedance(np.ones((1, 3)), 3.0) == pytest.approx(norm.sf(3.0), rel=1e-12)
    assert maximum.exceedance(np.array([[1.0, 2], [-1, -2]]), 3.0) == pytest.approx(2 * norm.sf(3.0), rel=1e-12)


def test_plane_and_union_estimators_agree():
    flat = phases(0, 10, 100)
    lifted = np.c_[flat, [0.0, 1e-6, -1e-6]]
    assert maximum.exceedance(lifted, 4.0) == pytest.approx(maximum.exceedance(flat, 4.0), rel=0.01)


@pytest.mark.parametrize("h", [2.0, 3.0])
def test_union_estimator_against_the_multivariate_normal(h):
    e = np.random.default_rng(3).normal(size=(5, 4))
    e /= np.linalg.norm(e, axis=1)[:, None]
    inside = multivariate_normal(np.zeros(5), e @ e.T, allow_singular=True, seed=1, maxpts=200_000).cdf(np.full(5, h))
    assert maximum.exceedance(e, h) == pytest.approx(1 - inside, rel=0.02)


def test_union_estimator_against_simulation_at_a_rate_that_can_be_counted():
    rng = np.random.default_rng(4)
    e = rng.normal(size=(12, 5))
    e /= np.linalg.norm(e, axis=1)[:, None]
    h = maximum.maximum_threshold(e, 0.01)
    hits = np.mean((rng.normal(size=(400_000, 5)) @ e.T).max(axis=1) > h)
    assert hits == pytest.approx(0.01, abs=3 * np.sqrt(0.01 / 400_000) + 1e-4)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0, 360), min_size=1, max_size=6), st.floats(1e-8, 1e-2))
def test_probability_lies_between_one_test_and_all_of_them(degrees, rate):
    e = phases(*degrees)
    h = maximum.maximum_threshold(e, rate)
    assert norm.isf(rate) - 1e-4 <= h <= norm.isf(rate / len(degrees)) + 1e-4
    assert maximum.exceedance(e, h) == pytest.approx(rate, rel=2e-3)


def test_shares_add_up_to_the_union():
    e = np.random.default_rng(5).normal(size=(4, 3))
    assert maximum.shares(e, 3.0).sum() == pytest.approx(maximum.tests_counted(e, 3.0), rel=0.01)


def test_shares_of_twins_are_halves():
    assert maximum.shares(np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), 4.0)[:2] == pytest.approx(0.5, abs=1e-3)


def test_zero_direction_is_refused():
    with pytest.raises(BadInput, match="none of length 0"):
        maximum.maximum_threshold(np.array([[0.0, 0.0], [1.0, 0.0]]), 1e-3)
