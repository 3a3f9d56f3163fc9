import numpy as np
import pytest

from afdsvc.explain.gap.blocks import contiguous_blocks
from afdsvc.explain.gap.ridge import Ridge
from afdsvc.explain.gap.settings import GapSettings

SETTINGS = GapSettings(folds=5, needed_blocks=5)


def setup(seed=1):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(300, 6))
    e = phi[:, :2] @ np.array([[1.0], [0.5]]) + 0.3 * rng.normal(size=(300, 1))
    cut = contiguous_blocks([180, 120], 4.0, SETTINGS)
    return Ridge(phi, np.array([0, 0, 0, 1, 1, 1]), cut, SETTINGS), phi, e, cut


def test_errors_are_those_of_a_regression_fitted_without_the_fold():
    ridge, phi, e, cut = setup()
    scores = ridge.scores(ridge.products(e))
    for tier, used in ((0, phi[:, :3]), (1, phi)):
        for k in range(cut.folds):
            out = np.r_[cut.rows(k), cut.neighbours(k)]
            rest = np.setdiff1d(np.arange(300), out)
            for i, penalty in enumerate(ridge.ridges):
                w = np.linalg.solve(used[rest].T @ used[rest] + penalty * np.eye(used.shape[1]), used[rest].T @ e[rest])
                expected = ((e - used @ w)[cut.rows(k)] ** 2).sum()
                assert scores.errors[tier, k, i, 0] == pytest.approx(expected, rel=1e-6)


def test_weights_and_share_agree_with_the_scores():
    ridge, phi, e, cut = setup(2)
    products = ridge.products(e)
    scores = ridge.scores(products)
    tier, chosen = scores.choice(0)
    used = ridge.tiers <= tier
    assert ridge.share(used, chosen, products)[0] == pytest.approx(scores.best()[0], abs=1e-9)
    errors = [((e - phi[:, used] @ ridge.weights(k, used, chosen, products))[cut.rows(k)] ** 2).sum() for k in range(cut.folds)]
    np.testing.assert_allclose(errors, scores.errors[tier, :, chosen, 0], rtol=1e-6)


def test_a_residual_without_power_is_not_predicted():
    ridge, *_ = setup(3)
    assert ridge.scores(ridge.products(np.zeros((300, 2)))).best().tolist() == [0.0, 0.0]
