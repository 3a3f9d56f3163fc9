"""Steps of a fit at the ends of parameter ranges, and starts that a law without an amplitude needs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from afdsvc.explain.fit import _within


def problem(seed: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((size + 3, size)), rng.standard_normal(size + 3)


@given(st.integers(0, 10_000), st.integers(1, 5))
def test_nothing_at_an_end_leaves_its_range_and_the_step_goes_down(seed, size):
    J, r = problem(seed, size)
    rng = np.random.default_rng(seed + 1)
    low, high = rng.random(size) < 0.3, rng.random(size) < 0.3
    move = _within(J.T @ J, J.T @ r, low, high & ~low)
    assert not (low & (move < 0)).any()
    assert not (high & ~low & (move > 0)).any()
    assert float((J.T @ r) @ move) <= 1e-12
    assert np.linalg.norm(r + J @ move) <= np.linalg.norm(r) * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_one_at_an_end_is_the_bounded_least_squares_step(seed):
    """Oracle: scipy's bounded least squares."""
    J, r = problem(seed, 3)
    low = np.array([True, False, False])
    best = lsq_linear(J, -r, bounds=(np.where(low, 0.0, -np.inf), np.inf), tol=1e-14)
    assert _within(J.T @ J, J.T @ r, low, ~np.ones(3, bool)) == pytest.approx(best.x, abs=1e-6)


def test_all_at_their_ends_stay():
    J, r = np.eye(2), np.array([1.0, 2.0])
    assert _within(J, r, np.ones(2, bool), np.zeros(2, bool)) == pytest.approx([0, 0])
