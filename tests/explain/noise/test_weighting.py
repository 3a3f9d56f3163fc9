"""Correlation times, surrogates and the weighting against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.explain.noise.surrogates import chance, rephased
from afdsvc.explain.noise.weighting import correlation_time, even, noise_share, power_time


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_the_correlation_time_of_first_order_noise(a):
    e = lfilter([1.0], [1.0, -a], np.random.default_rng(3).normal(size=(60_000, 1)), axis=0)
    assert correlation_time([e]) == pytest.approx((1 + a) / (1 - a), rel=0.15)


@pytest.mark.parametrize(("decay", "angle"), [(200.0, 0.1), (50.0, 0.3)])
def test_the_power_of_an_oscillation_is_independent_after_as_long_as_it_lasts(decay, angle):
    """Noise that rings: the squares of the autocorrelation of its filter, summed over all lags, where the variance of its power says the same."""
    a = [1.0, *np.poly(np.exp([-1 / decay + 1j * angle, -1 / decay - 1j * angle])).real[1:]]
    response = lfilter([1.0], a, np.eye(1, 40_000)[0])
    rho = np.correlate(np.pad(response, (0, len(response))), response, mode="valid") / (response @ response)
    noise = lfilter([1.0], a, np.random.default_rng(5).normal(size=(400, 22_000)))[:, 2000:]
    powers, expected = (noise**2).mean(1), 2 * (rho**2).sum() - 1
    assert powers.var() / powers.mean() ** 2 * 20_000 / 2 == pytest.approx(expected, rel=0.3)
    pieces = [*noise[:80].reshape(4, -1, 1)]
    assert power_time(pieces) == pytest.approx(expected, rel=0.1)
    assert power_time(pieces) > 3 * correlation_time(pieces)


def test_the_power_of_slow_noise_is_independent_after_its_correlation_time():
    slow = lfilter([1.0], [1.0, -0.9], np.random.default_rng(6).normal(size=(20_000, 2)), axis=0)
    assert power_time([slow]) == correlation_time([slow])


def test_surrogates_keep_power_and_colour():
    rng = np.random.default_rng(4)
    e = lfilter([1.0], [1.0, -0.8], rng.normal(size=(20_000, 2)), axis=0)
    other = rephased(e, rng)[:, :, 0]
    assert other.std(0) == pytest.approx(e.std(0), rel=1e-3)  # all but the last line of the spectrum, whose phase is 0 or pi
    assert correlation_time([other]) == pytest.approx(correlation_time([e]), rel=0.2)
    assert abs(np.corrcoef(e[:, 0], other[:, 0])[0, 1]) < 0.1


def test_chance_is_the_largest_of_chi_squares_for_white_noise():
    """The oracle draws them: of 99 surrogates, along 50 directions each. One set of surrogates says it as well as another."""
    rng = np.random.default_rng(5)
    e = rng.normal(size=(2000, 1))
    directions = rng.normal(size=(50, 2000))
    found = [chance([e], [len(e)], directions, np.ones(e.size), 99, rng) for _ in range(30)]
    largest = (0.5 * rng.normal(size=(1000, 99, 50)) ** 2).max((1, 2))
    assert np.mean(found) == pytest.approx(largest.mean(), rel=0.1)
    assert np.std(found) < 0.6 * largest.std()


def test_chance_takes_the_noise_not_the_lines_beside_it():
    """A residual that is one line of the excitation: its own surrogates reach what the line gains, those of the noise do not."""
    rng = np.random.default_rng(7)
    line = 5.0 * np.cos(2 * np.pi * 40 * np.arange(2000) / 2000)[:, None]
    noise = rng.normal(size=(1000, 1))
    directions = np.stack([np.cos(2 * np.pi * k * np.arange(2000) / 2000) for k in (40, 41, 90)])
    of_noise = chance([noise], [2000], directions, np.ones(2000), 100, rng)
    of_residual = chance([line + rng.normal(size=(2000, 1))], [2000], directions, np.ones(2000), 100, rng)
    assert of_noise < 0.02 * of_residual


def test_the_share_of_noise_is_what_does_not_repeat_the_mean_over_outputs():
    """Of one output noise is a fifth of the power, of the other all."""
    rng = np.random.default_rng(8)
    repeats = np.column_stack([np.tile(2.0 * rng.normal(size=500), 20), np.zeros(10_000)])
    e = repeats + rng.normal(size=(10_000, 2))
    assert noise_share([SimpleNamespace(period=500, settled=0)], [e]) == pytest.approx(0.6, rel=0.03)
    assert noise_share([SimpleNamespace(period=0, settled=0)], [e]) == 0.0


def test_the_even_weighting_changes_nothing():
    e = np.random.default_rng(6).normal(size=(100, 2))
    assert even(2)(e) == pytest.approx(e)
