"""The compressed factor holds the data matrix exactly, by either route, in memory that does not grow with the samples."""

import tracemalloc

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.identify.numerics.compression import compress, compress_groups, factor_of, join, lags, leave_out


def _recordings(seed=0, lengths=(300, 170), m=2, p=1):
    rng = np.random.default_rng(seed)
    return [InputOutputData.of(rng.standard_normal((n, m)), rng.standard_normal((n, p)), 1.0) for n in lengths]


def _windows(recordings, length):
    rows = []
    for r in recordings:
        w = np.hstack([r.u, r.y])
        rows += [w[k : k + length].ravel() for k in range(len(w) - length + 1)]
    return np.array(rows)


@pytest.mark.parametrize("route", ["qr", "gram", "auto"])
def test_factor_has_the_cross_products_of_all_windows(route):
    recordings = _recordings()
    R, H = compress(recordings, 7, route), _windows(recordings, 7)
    assert np.allclose(np.tril(R, -1), 0)
    assert np.abs(R.T @ R - H.T @ H).max() < 1e-11 * np.abs(H.T @ H).max()


def test_automatic_route_leaves_the_fast_one_where_the_data_are_nearly_dependent():
    rng = np.random.default_rng(1)
    slow = np.cumsum(np.cumsum(rng.standard_normal((4000, 1)), axis=0), axis=0)  # windows nearly collinear
    recordings = [InputOutputData.of(slow / slow.std(), rng.standard_normal((4000, 1)), 1.0)]
    exact, chosen = compress(recordings, 12, "qr"), compress(recordings, 12, "auto")
    assert np.linalg.cond(exact) > 1e4
    assert np.array_equal(chosen, exact)


def test_groups_together_hold_all_the_data():
    recordings = _recordings(lengths=(500, 333))
    whole, parts = compress(recordings, 6, "qr"), compress_groups(recordings, 6, 7)
    assert len(parts) == 7
    joined, H = join(parts), _windows(recordings, 6)
    assert np.abs(joined.T @ joined - whole.T @ whole).max() < 1e-11 * np.abs(whole.T @ whole).max()
    for g, rest in enumerate(leave_out(parts)):
        own = slice(g * len(H) // 7, (g + 1) * len(H) // 7)
        others = np.delete(H, own, axis=0)
        assert np.abs(rest.T @ rest - others.T @ others).max() < 1e-11 * np.abs(whole.T @ whole).max()


def test_lags_name_the_columns_of_a_window():
    H = _windows([InputOutputData.of(np.arange(10.0)[:, None], 100 + np.arange(10.0)[:, None], 1.0)], 4)
    assert H[0, lags(2, [1], 1, 3)].tolist() == [101.0, 102.0]


def test_factor_of_blocks_equals_factor_of_the_whole():
    X = np.random.default_rng(2).standard_normal((200, 5))
    R = factor_of(lambda: iter([X[:77], X[77:]]))
    assert np.allclose(R.T @ R, X.T @ X, rtol=1e-12)
    singular = np.hstack([X, X[:, :1]])
    R = factor_of(lambda: iter([singular[:77], singular[77:]]))
    assert np.allclose(R.T @ R, singular.T @ singular, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("route", ["qr", "auto"])
def test_memory_does_not_grow_with_the_samples(route):
    def extra(samples):
        recordings = _recordings(lengths=(samples,))
        tracemalloc.start()
        compress(recordings, 20, route)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return peak - samples * 3 * 8  # the stacked signals themselves

    small, large = extra(20_000), extra(80_000)
    assert large < 1.5 * small + 60_000 * 3 * 8


def test_too_few_samples_and_unknown_route_are_named():
    with pytest.raises(BadInput, match="20 samples are too short for windows of 8 lags"):
        compress(_recordings(lengths=(20,)), 8)
    with pytest.raises(BadInput, match="compression route 'fast'"):
        compress(_recordings(), 5, "fast")  # type: ignore[arg-type]
