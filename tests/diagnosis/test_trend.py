"""The forecast of when a fault reaches a limit: its interval holds, and what is no trend gets none."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.diagnosis.trend import FEWEST, forecast


def wear(rng, days=40, rate=-0.004, sd=0.01):
    t = np.sort(rng.uniform(0, days, 60))
    return t, -0.1 + rate * t + sd * rng.standard_normal(60), np.full(60, sd)


def test_the_interval_holds_in_95_of_100_repetitions():
    rng, true = np.random.default_rng(5), 100.0
    found = [f for f in (forecast(*wear(rng), -0.5) for _ in range(400)) if f and f.reaches]
    assert len(found) > 390
    assert 0.92 <= np.mean([f.earliest <= true <= f.latest for f in found]) <= 0.98  # 3 standard errors


def test_a_rate_that_changed_is_followed_by_its_present_value():
    t = np.arange(60.0)
    value = np.where(t < 40, -0.05, -0.05 - 0.01 * (t - 40))
    found = forecast(t, value + 0.002 * np.random.default_rng(0).standard_normal(60), np.full(60, 0.002), -0.5)
    assert found is not None
    assert found.slope == pytest.approx(-0.01, abs=0.001)
    assert found.reaches == pytest.approx(85, abs=4)


def test_what_stays_or_heals_reaches_nothing():
    t, sd = np.arange(30.0), np.full(30, 0.01)
    noise = 0.01 * np.random.default_rng(2).standard_normal(30)
    assert forecast(t, -0.2 + noise, sd, -0.5).reaches is None
    healing = forecast(t, -0.4 + 0.01 * t + noise, sd, -0.5)
    assert (healing.reaches, healing.slope > 0) == (None, True)


def test_too_few_or_scattered_estimates_are_no_line():
    assert forecast(range(FEWEST - 1), [-0.1] * (FEWEST - 1), [0.01] * (FEWEST - 1), -0.5) is None
    assert forecast(range(6), [-0.1, -0.5, -0.1, -0.5, -0.1, -0.5], [0.01] * 6, -0.5) is None
