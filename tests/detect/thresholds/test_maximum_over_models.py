"""The union of projections over uncertain machines, against plain simulation."""

import numpy as np
import pytest

from afdsvc.detect.thresholds import maximum
from afdsvc.detect.thresholds.maximum import Mixture


def made(seed=2, Q=7, K=9, D=4):
    rng = np.random.default_rng(seed)
    e = rng.normal(size=(K, D))
    roots = np.eye(D) + 0.2 * rng.normal(size=(Q, D, D))
    return Mixture(rng.dirichlet(np.ones(Q)), rng.normal(size=(Q, D)), roots, e / np.linalg.norm(e, axis=1)[:, None])


def test_exceedance_against_simulation():
    found, rng, n = made(), np.random.default_rng(3), 400_000
    heights = np.linspace(2.6, 3.6, 9)
    q = rng.choice(len(found.weights), size=n, p=found.weights)
    z = found.means[q] + np.einsum("nij,nj->ni", found.roots[q], rng.normal(size=(n, 4)))
    hits = np.mean((z @ found.directions.T > heights).any(axis=1))
    assert found.exceedance(heights) == pytest.approx(hits, abs=2.58 * np.sqrt(hits / n) + 0.01 * hits)


def test_threshold_inverts_the_exceedance_from_any_guess():
    found = made()
    for start in (0.5, 4.0):
        h = found.threshold(lambda c: np.full(9, c), 1e-4, start)
        assert found.exceedance(np.full(9, h)) == pytest.approx(1e-4, rel=1e-3)


def test_one_standard_model_is_the_maximum_of_projections():
    e = made().directions
    one = Mixture(np.ones(1), np.zeros((1, 4)), np.eye(4)[None], e)
    assert one.threshold(lambda c: np.full(9, c), 1e-3, 3.0) == pytest.approx(maximum.maximum_threshold(e, 1e-3), abs=0.005)
