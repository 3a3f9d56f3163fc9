"""Run lengths of the CUSUM test."""

import math

import numpy as np
import pytest

from afdsvc.detect.thresholds import average_run_length
from afdsvc.errors import BadInput


def chain(mu, b, states=1200, changed=False):
    """Average run length by a fine Markov chain (Brook and Evans), independent of the integral equation."""
    from scipy.stats import norm

    w = b / states
    drift = mu**2 / 2 * (1 if changed else -1)
    x = (np.arange(states) + 0.5) * w
    edges = np.arange(states + 1) * w
    P = np.diff(norm.cdf((edges[None, :] - x[:, None] - drift) / mu), axis=1)
    to_zero = norm.cdf((-x - drift) / mu)
    Q = np.zeros((states + 1, states + 1))
    Q[1:, 1:], Q[1:, 0] = P, to_zero
    Q[0, 1:], Q[0, 0] = np.diff(norm.cdf((edges - drift) / mu)), norm.cdf(-drift / mu)
    return np.linalg.solve(np.eye(states + 1) - Q, np.ones(states + 1))[0]


# Hawkins and Olwell, "Cumulative Sum Charts" (1998), one-sided, allowance 0.5, decision interval 4 and 5: 335.37, 930.89.
# Allowance k and interval h in standard deviations are mu = 2 k and b = mu h here.
@pytest.mark.parametrize(("interval", "length"), [(4.0, 335.37), (5.0, 930.89)])
def test_published_run_lengths(interval, length):
    assert average_run_length.run_length(1.0, interval) == pytest.approx(length, rel=1e-4)


@pytest.mark.parametrize(("mu", "b"), [(0.3, 4.0), (1.0, 6.0), (2.5, 5.0)])
@pytest.mark.parametrize("changed", [False, True])
def test_integral_equation_against_markov_chain(mu, b, changed):
    assert average_run_length.run_length(mu, b, changed) == pytest.approx(chain(mu, b, changed=changed), rel=2e-3)


def test_small_steps_join_the_diffusion_smoothly():
    exact = average_run_length.run_length(0.05, 0.05 * 149.9)
    formula = average_run_length.run_length(0.05, 0.05 * 150.1)
    assert formula / exact == pytest.approx(math.exp(0.05 * 0.2), rel=1e-3)


@pytest.mark.parametrize("mu", [0.01, 0.3, 1.0, 6.0])
@pytest.mark.parametrize("samples", [1e3, 1e7, 1e13])
def test_boundary_inverts_run_length(mu, samples):
    if samples > 2 * average_run_length.run_length(mu, 1e-9):
        assert average_run_length.run_length(mu, average_run_length.boundary(mu, samples)) == pytest.approx(samples, rel=1e-4)


@pytest.mark.parametrize(("mu", "b", "n"), [(0.5, 6.0, 400), (0.05, 3.0, 4000), (2.0, 6.0, 50)])
def test_alarm_probability_against_simulation(mu, b, n):
    rng, runs = np.random.default_rng(7), 20_000
    g, hit = np.zeros(runs), np.zeros(runs, bool)
    for _ in range(n):
        g = np.maximum(0.0, g + rng.normal(-(mu**2) / 2, mu, runs))
        hit |= g > b
    p = average_run_length.alarm_probability(mu, b, n)
    assert hit.mean() == pytest.approx(p, abs=2.58 * math.sqrt(p / runs) + 0.02 * p)


@pytest.mark.parametrize("rate", [1e-1, 1e-3, 1e-4])
def test_burst_boundary_keeps_the_rate(rate):
    b = average_run_length.burst_boundary(0.3, 3000, rate)
    assert average_run_length.alarm_probability(0.3, b, 3000) == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize("bias", [-1e-3, -10.0])
def test_a_run_length_beyond_any_float_is_infinite(bias):
    """A model that is wrong by much may hold the test at zero: with -1e-3 it is long, with -10 no float holds it."""
    length = average_run_length.run_length(0.05, 20.0, bias=bias, step=0.05)
    assert (length == math.inf) is (bias == -10.0)
    assert length > average_run_length.run_length(0.05, 20.0, step=0.05)


def test_nonsense_is_named():
    with pytest.raises(BadInput, match="positive"):
        average_run_length.run_length(-1.0, 3.0)
    with pytest.raises(BadInput, match="expected"):
        average_run_length.boundary(1.0, 1.0)
