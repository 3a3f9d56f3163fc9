"""The covariance that decides how sure parameters are: against a sum over lags, and against a Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.explain.surest import _long_run


def test_two_running_means_are_bartletts_kernel():
    """Oracle: Newey and West's weighted sum over lags, written out."""
    rng = np.random.default_rng(1)
    g, lags = rng.standard_normal((300, 3)), 7
    summed = g.T @ g
    for k in range(1, lags):
        summed += (1 - k / lags) * (g[k:].T @ g[:-k] + g[:-k].T @ g[k:])
    assert _long_run(g, lags) == pytest.approx(summed)


def test_it_knows_how_far_the_mean_of_a_coloured_residual_strays():
    """The sum of 4000 samples of a first-order process, 400 times: the spread within 15 %, where white noise's is 2.4 times less."""
    rng = np.random.default_rng(2)
    rows = lfilter([1.0], [1.0, -0.7], rng.standard_normal((400, 4500)), axis=1)[:, 500:]
    told = np.mean([float(_long_run(x[:, None], 60)[0, 0]) for x in rows[:50]])
    seen = float(np.var(rows.sum(1)))
    assert told == pytest.approx(seen, rel=0.15)
    assert float(np.mean((rows[:50] ** 2).sum(1))) < 0.3 * seen
