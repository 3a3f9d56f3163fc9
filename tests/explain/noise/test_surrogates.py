import numpy as np
import pytest

from afdsvc.explain.noise.surrogates import autoregressive, surrogates
from tests.explain.gap.machines import coloured


def made(seed=1, count=20):
    rng = np.random.default_rng(seed)
    e = coloured(2000, 30.0, rng, 2) @ np.array([[1.0, 0.6], [0.0, 0.8]])
    e = e - e.mean(0)
    return e, surrogates([e], [autoregressive([x], 10) for x in e.T], count, rng)[0]


def test_the_first_column_is_the_residual():
    e, out = made()
    assert out.shape == (2000, 2, 41)
    np.testing.assert_allclose(out[:, :, 0], e, atol=1e-12)


def test_phases_keep_spectrum_and_correlation_between_outputs():
    e, out = made(2)
    for i in range(21, 41):
        np.testing.assert_allclose(np.abs(np.fft.rfft(out[:, :, i], axis=0))[:-1], np.abs(np.fft.rfft(e, axis=0))[:-1], atol=1e-8)
        assert np.corrcoef(out[:, :, i].T)[0, 1] == pytest.approx(np.corrcoef(e.T)[0, 1], abs=1e-6)


def test_signs_keep_colour_and_do_not_follow_the_residual():
    e, out = made(3)
    neighbours = [np.corrcoef(out[1:, 0, i], out[:-1, 0, i])[0, 1] for i in range(1, 21)]
    assert np.median(neighbours) == pytest.approx(np.corrcoef(e[1:, 0], e[:-1, 0])[0, 1], abs=0.02)
    assert abs(np.mean([np.corrcoef(out[:, 0, i], e[:, 0])[0, 1] for i in range(1, 21)])) < 0.15
