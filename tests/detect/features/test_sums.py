"""Shared sums refuse samples of another shape: compiled code would read and write beyond them."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.detect.features.sums import Products
from afdsvc.detect.statistics.cusum import cusum
from afdsvc.errors import BadInput


def test_sums_of_products_are_those_of_numpy():
    rng = np.random.default_rng(0)
    series = rng.normal(size=(50, 3, 2))
    found = Products.empty(2, 4).add(series[:20]).add(series[20:])
    flat = series.reshape(50, 6)
    e, f = flat[:, :2], flat[:, 2:]
    theta = rng.normal(size=(3, 2, 4))
    assert np.allclose(found.score(theta), np.einsum("kpf,tf,tp->k", theta, f, e))
    psi = np.einsum("kpf,tf->ktp", theta, f)
    assert np.allclose(found.information(theta), np.einsum("ktp,ltp->kl", psi, psi))


def test_series_with_other_features_are_refused():
    with pytest.raises(BadInput, match="series of 10 columns; expected 2 of the residual and 4 features"):
        Products.empty(2, 4).add(np.zeros((5, 5, 2)))
    test = cusum(np.ones((3, 2, 4)), np.full(3, -0.5), [0, 1, 2], 5, 10.0)
    with pytest.raises(BadInput, match="series of 7 columns"):
        test.step(test.start(), np.zeros((5, 7)))
