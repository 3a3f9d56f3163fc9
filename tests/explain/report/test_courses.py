"""Errors on recordings that were not fitted."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.explain.report.courses import fits, nrmse
from afdsvc.explain.report.explanation import RecordingCourse


def test_the_error_is_the_ratio_of_the_norms_about_the_mean():
    y = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, np.nan]])
    simulated = np.array([[1.0, 2.0], [3.0, 5.0], [6.0, 7.0]])
    assert nrmse(y, simulated) == pytest.approx([np.sqrt(1 / 8), np.sqrt(1 / 2)])


def test_a_simulation_that_left_has_no_finite_error():
    y = np.arange(4.0)[:, None]
    assert np.isinf(nrmse(y, np.array([[0.0], [1.0], [np.nan], [np.nan]])))[0]


def test_recordings_held_out_count_together_and_the_noise_is_over_their_spread():
    t, y = np.arange(3.0), np.array([[0.0], [1.0], [2.0]])
    held = [RecordingCourse(name, "heldout", t, y, 0 * y, y + 0.1) for name in "ab"]
    (found,) = fits(held, ["position"], [0.05])
    assert found.before_nrmse == pytest.approx(np.sqrt(5 / 2))
    assert found.after_nrmse == pytest.approx(0.1 / y.std())
    assert found.noise_floor_nrmse == pytest.approx(0.05 / y.std())
