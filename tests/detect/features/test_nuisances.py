"""Recursive residuals are the orthonormal complement of the nuisances."""

import numpy as np
import pytest
from scipy.stats import kstest

from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.errors import BadInput

DT = 2e-4
ALL = Nuisances(True, (2 * np.pi * 50, 2 * np.pi * 100), (1, 2))


def block(n, angle=None, first=0):
    empty = np.zeros((n, 2))
    return ResidualBlock(first, DT, empty, empty, empty, empty, empty, aux={} if angle is None else {"angle": angle})


def functions(n, angle):
    t = np.arange(n) * DT
    waves = [f(2 * np.pi * hz * t) for hz in (50, 100) for f in (np.sin, np.cos)]
    return np.column_stack([np.ones(n), t, *waves, *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos))])


def spoilt(n, seed):
    """Residual and two regressors among large nuisances, the rotor angle (its speed wanders), and the nuisances."""
    rng = np.random.default_rng(seed)
    angle = 115.0 * np.arange(n) * DT + 0.3 * np.sin(2.0 * np.arange(n) * DT)
    N = functions(n, angle)
    series = rng.normal(size=(n, 3, 2))
    series[:, 0] += -0.3 * series[:, 1] + N @ rng.normal(size=(N.shape[1], 2)) * 50
    series[:, 1] += N @ rng.normal(size=(N.shape[1], 2)) * 5
    return series, angle, N


def test_sums_of_products_are_those_of_least_squares_residuals():
    series, angle, N = spoilt(4000, 1)
    _, clean, _ = ALL.clean(None, block(4000, angle), series)
    Q = np.linalg.qr(N)[0]
    flat = series.reshape(4000, -1)
    left = flat - Q @ (Q.T @ flat)
    found = clean.reshape(4000, -1)
    assert found.T @ found == pytest.approx(left.T @ left, rel=1e-4, abs=1e-3)


def test_white_noise_stays_white_with_unit_variance():
    rng, n = np.random.default_rng(2), 625 * 16
    angle = 115.0 * np.arange(n) * DT
    noise = rng.normal(size=(n, 1, 2)) + 100 * np.sin(angle + 1)[:, None, None]
    _, clean, kept = ALL.clean(None, block(n, angle), noise, 625)
    e = clean[kept, 0]
    assert kept.mean() > 0.8
    assert kstest(e.ravel(), "norm").pvalue > 0.01
    assert abs(np.mean(e[1:] * e[:-1])) < 2.58 / np.sqrt(e.size)


def test_blocks_of_any_size_give_the_same_bits():
    series, angle, _ = spoilt(2000, 3)
    _, whole, _ = ALL.clean(None, block(2000, angle), series, 300)
    state, parts = None, []
    for a in range(0, 2000, 37):
        part = series[a : a + 37]
        state, clean, _ = ALL.clean(state, block(len(part), angle[a : a + 37], a), part, 300)
        parts.append(clean)
    assert np.array_equal(np.concatenate(parts), whole)


def test_without_nuisances_nothing_is_touched():
    series = np.ones((5, 2, 2))
    state, clean, kept = Nuisances().clean(None, block(5), series)
    assert state is None
    assert clean is series
    assert kept.all()


def test_a_rotor_that_stands_still_is_no_trouble():
    noise = np.random.default_rng(4).normal(size=(5000, 1, 2))
    _, clean, kept = Nuisances(orders=(1, 2)).clean(None, block(5000, np.full(5000, 0.7)), noise)
    assert np.isfinite(clean).all()
    assert kept.sum() >= 4990


def test_a_missing_angle_is_an_error_only_when_it_was_asked_for():
    with pytest.raises(BadInput, match="no aux 'angle'"):
        Nuisances(orders=(1,)).turning(block(3))
    assert not Nuisances(orders=(1,), if_recorded=True).turning(block(3))
    assert Nuisances(orders=(1,), if_recorded=True).turning(block(3, np.zeros(3)))
