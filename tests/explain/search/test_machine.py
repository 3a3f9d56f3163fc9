"""What the recordings say of a signal."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Variable
from afdsvc.explain.search.machine import _sizes


@pytest.mark.parametrize(("low", "high", "reverses"), [(-1.0, 1.0, True), (-0.2, 1.0, True), (-0.02, 1.0, False), (0.5, 1.0, False), (-1.0, -0.5, False)])
def test_a_signal_reverses_where_both_signs_are_more_than_noise_about_rest(low, high, reverses):
    values = np.linspace(low, high, 1000)[:, None]
    (size,) = _sizes([Variable("w", "rad/s")], values)
    assert size.reverses is reverses
    assert size.reach == pytest.approx(max(np.abs(values - values.mean()).max(), 3 * values.std()), rel=1e-9) or low * high < 0
