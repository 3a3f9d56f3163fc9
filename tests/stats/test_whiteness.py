"""The whiteness test: level, oracle, independence of the cut into blocks."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.stats.whiteness import LagSums, whiteness, whiteness_without


def sums_of(series, lags=20, cut=None):
    total = LagSums.empty(lags, series.shape[1] - 1, series.shape[2])
    for part in np.array_split(series, cut or 1):
        total = total.add(part)
    return total


def test_level_is_kept_for_white_data():
    rng, runs = np.random.default_rng(8), 3000
    p = np.array([whiteness(sums_of(rng.normal(size=(1500, 1, 2)))).p for _ in range(runs)])
    for level in (0.1, 0.01):
        assert np.mean(p < level) <= level + 2.58 * np.sqrt(level * (1 - level) / runs)
        assert np.mean(p < level) >= 0.5 * level


def test_portmanteau_equals_ljung_box_for_one_output():
    x = np.random.default_rng(9).normal(size=800)
    n, lags = len(x), 12
    r = np.array([np.sum(x[k:] * x[: n - k]) for k in range(lags + 1)]) / np.sum(x * x)
    Q = n * n * np.sum(r[1:] ** 2 / (n - np.arange(1, lags + 1)))  # Ljung-Box with n^2 for n (n + 2)
    from scipy.stats import chi2

    found = whiteness(sums_of(x[:, None, None], lags))
    assert found.portmanteau == pytest.approx(chi2.sf(Q, lags), rel=1e-9)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda x: x[1:] + 0.4 * x[:-1], "standard deviation|not white"),
        (lambda x: 1.2 * x, "1.2 times the stated"),
        (lambda x: x + 0.15, "mean of|standard deviation|not white"),
    ],
)
def test_each_departure_is_named(spoil, words):
    x = spoil(np.random.default_rng(10).normal(size=(4000, 1, 1)))
    found = whiteness(sums_of(x))
    assert found.p < 1e-3
    assert __import__("re").search(words, found.reason(1e-3))


def test_sums_do_not_depend_on_the_cut_to_the_last_bit():
    x = np.random.default_rng(11).normal(size=(997, 3, 2))
    whole, pieces = sums_of(x), sums_of(x, cut=83)
    for name in ("residual", "cross", "own", "mean", "past"):
        assert np.array_equal(getattr(whole, name), getattr(pieces, name)), name


def test_taking_out_a_regressor_equals_testing_the_difference():
    rng = np.random.default_rng(12)
    x = rng.normal(size=(2000, 2, 2))
    theta = -0.37
    direct = whiteness(sums_of(x[:, :1] - theta * x[:, 1:]))
    assert whiteness_without(sums_of(x), 0, theta).p == pytest.approx(direct.p, rel=1e-9)


def test_severity_is_least_squares():
    rng = np.random.default_rng(13)
    psi, e = rng.normal(size=(3000, 1, 2)), rng.normal(size=(3000, 1, 2))
    found, sd = sums_of(np.concatenate([e - 0.25 * psi, psi], axis=1)).severity(0)
    flat = psi.ravel()
    assert found == pytest.approx(np.linalg.lstsq(flat[:, None], (e - 0.25 * psi).ravel(), rcond=None)[0][0], rel=1e-9)
    assert sd == pytest.approx(1 / np.linalg.norm(flat), rel=1e-9)


def test_too_few_samples_are_refused():
    with pytest.raises(BadInput, match="at least 200"):
        whiteness(sums_of(np.zeros((50, 1, 1))))


def test_a_residual_that_diverges_is_not_white_and_no_error():
    """What is left of sums of 1e30 after a regressor is taken out is rounding, and may be negative."""
    rng, growth = np.random.default_rng(4), np.exp(np.linspace(0, 69, 1500))[:, None]
    for seed in range(20):
        psi = growth * rng.normal(size=(1500, 2))
        found = whiteness_without(sums_of(np.stack([-0.3 * psi + rng.normal(size=psi.shape), psi], axis=1)), 0, -0.3)
        assert found.p < 1e-6, seed
        assert np.isfinite(found.sd_ratio).all()
