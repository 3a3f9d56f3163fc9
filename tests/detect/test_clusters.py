"""Alarms per hour of a sliding window."""

import numpy as np
import pytest

from afdsvc.detect import clusters
from afdsvc.errors import BadInput


# Thresholds for one alarm per hour, day, 30 days (Siegmund's formula evaluated independently).
@pytest.mark.parametrize(
    ("window", "rate_hz", "thresholds"),
    [
        (12500, 5000, (3.92146, 4.69932, 5.39932)),
        (1000, 5000, (4.53085, 5.20828, 5.84152)),
        (200, 1000, (4.49584, 5.17380, 5.80741)),
    ],
)
def test_thresholds_for_one_alarm_per_hour_day_month(window, rate_hz, thresholds):
    for hours, h in zip((1, 24, 720), thresholds, strict=True):
        assert clusters.cluster_threshold(1 / (hours * 3600 * rate_hz), window) == pytest.approx(h, abs=1e-4)


@pytest.mark.parametrize(("pfa", "window", "rate_hz", "alarms"), [(2e-5, 12500, 5000, 0.4956), (1e-4, 200, 1000, 21.07)])
def test_a_rate_per_sample_is_not_a_rate_of_alarms(pfa, window, rate_hz, alarms):
    from scipy.stats import norm

    assert clusters.alarm_rate(norm.isf(pfa), window) * 3600 * rate_hz == pytest.approx(alarms, rel=1e-3)


def test_alarm_rate_against_simulation():
    rng, window, h, n = np.random.default_rng(6), 200, 3.0, 4_000_000
    total = np.cumsum(rng.normal(size=n + window))
    T = (total[window:] - total[:-window]) / np.sqrt(window)
    above = np.flatnonzero(T > h)
    alarms = 1 + np.sum(np.diff(above) > window)
    expected = clusters.alarm_rate(h, window) * n
    assert alarms == pytest.approx(expected, abs=2.58 * np.sqrt(expected) + 0.04 * expected)


def test_siegmund_function_at_its_known_limits():
    assert clusters.siegmund(1e-12) == 1.0
    assert clusters.siegmund(0.1) == pytest.approx(np.exp(-0.583 * 0.1), abs=5e-3)


def test_a_rate_above_one_alarm_per_window_is_refused():
    with pytest.raises(BadInput, match="below one alarm per window"):
        clusters.cluster_threshold(0.5, 100)
