"""What the recordings say of a signal."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Variable
from afdsvc.explain.search.machine import _sizes


@pytest.mark.parametrize(("low", "high", "reverses"), [(-1.0, 1.0, True), (-0.2, 1.0, True), (-0.02, 1.0, False), (0.5, 1.0, False), (-1.0, -0.5, False)])
def test_a_signal_reverses_where_both_signs_are_more_than_noise_about_rest(low, high, reverses):
    (size,) = _sizes([Variable("w", "rad/s")], np.linspace(low, high, 1000)[:, None])
    assert size.reverses is reverses


def test_a_signal_reaches_as_far_from_its_mean_as_its_peak():
    (size,) = _sizes([Variable("gap", "mm")], np.concatenate([np.full(999, 5.0), [9.0]])[:, None])
    assert size.reach == pytest.approx(4.0, rel=1e-3)
