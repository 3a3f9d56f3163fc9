"""Thinning keeps every extreme and invents nothing."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from afdsvc.present.rerun.signals import envelope

values = arrays(np.float64, array_shapes(min_dims=2, max_dims=2, max_side=40), elements=st.floats(-1e6, 1e6))


@given(values, st.integers(0, 12))
def test_every_bin_keeps_its_extremes_in_their_order(x, width):
    rows, shown = envelope(x, width)
    assert rows.shape == (len(shown),)
    assert np.all(np.diff(rows) > 0)
    assert rows[-1] < len(x)
    if width <= 2:
        assert np.array_equal(shown, x)
        return
    for start in range(0, len(x) // width * width, width):
        bin_, kept = x[start : start + width], shown[(rows >= start) & (rows < start + width)]
        assert np.array_equal(np.sort(kept, axis=0), np.stack([bin_.min(axis=0), bin_.max(axis=0)]))
        for column, pair in zip(bin_.T, kept.T, strict=True):
            assert list(column).index(pair[0]) <= len(column) - 1 - list(column)[::-1].index(pair[1])
    rest = len(x) % width
    assert np.array_equal(shown[len(shown) - rest :], x[len(x) - rest :])


def test_nan_is_passed_over_but_a_bin_of_nan_stays():
    x = np.array([[1.0], [np.nan], [3.0], [np.nan], [np.nan], [np.nan]])
    rows, shown = envelope(x, 3)
    assert rows.tolist() == [0, 1, 3, 4]
    assert np.array_equal(shown[:, 0], [1.0, 3.0, np.nan, np.nan], equal_nan=True)
