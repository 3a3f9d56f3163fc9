import numpy as np
import pytest

from afdsvc.explain.gap.repeating import repeating_share
from afdsvc.explain.gap.settings import GapSettings
from afdsvc.explain.gap.signals import ResidualSignals
from tests.explain.gap.machines import coloured


def posed(e, period):
    n = len(e)
    return [ResidualSignals(e, np.zeros((n, 1)), np.zeros((n, 0)), np.zeros((n, 0)), 0.01, period)]


@pytest.mark.parametrize("time", [0.1, 10.0, 200.0])
def test_noise_does_not_repeat_whatever_its_colour(time):
    rng = np.random.default_rng(1)
    p = []
    for _ in range(60):
        e = coloured(2000, time, rng)
        p.append(repeating_share(posed(e, 400), [e], GapSettings()).p_value)
    assert np.mean(np.array(p) < 0.05) <= 0.12
    assert 0.3 < np.mean(p) < 0.7


@pytest.mark.parametrize("periods", [2, 5])
def test_what_repeats_is_found_and_measured(periods):
    rng = np.random.default_rng(2)
    one = coloured(400, 20.0, rng)
    e = np.tile(one / one.std(), (periods, 1)) + coloured(400 * periods, 20.0, rng)
    found = repeating_share(posed(e, 400), [e], GapSettings())
    assert found.p_value < 1e-3
    assert found.share[0] == pytest.approx(0.5, abs=0.2)


def test_one_period_or_missing_readings_allow_no_test():
    e = np.random.default_rng(3).normal(size=(500, 1))
    assert repeating_share(posed(e, 400), [e], GapSettings()) is None
    e[7] = np.nan
    assert repeating_share(posed(e, 100), [e], GapSettings()) is None


def test_a_residual_without_noise_that_repeats_is_certain():
    e = np.tile(np.sin(np.arange(100) * 2 * np.pi / 100), 4)[:, None]
    assert repeating_share(posed(e, 100), [e], GapSettings()).p_value < 1e-6
