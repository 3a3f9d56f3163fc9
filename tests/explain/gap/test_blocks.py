import numpy as np
import pytest

from afdsvc.explain.gap.blocks import bartlett_time, contiguous_blocks
from afdsvc.explain.gap.settings import GapSettings
from tests.explain.gap.machines import coloured


@pytest.mark.parametrize("time", [2.0, 20.0])
def test_correlation_time_of_first_order_noise_is_its_time_constant(time):
    e = coloured(200_000, time, np.random.default_rng(1), 2)
    a = np.exp(-2 / time)
    np.testing.assert_allclose(bartlett_time([e], 0.01), (1 + a) / (1 - a), rtol=0.1)


def test_white_noise_has_a_correlation_time_of_one_sample():
    assert bartlett_time([np.random.default_rng(2).normal(size=(5000, 1))], 0.05)[0] == pytest.approx(1.0, abs=0.15)


def test_an_oscillation_counts_its_envelope():
    t = np.arange(20000)
    e = (np.exp(-t / 300) * np.cos(0.3 * t))[:, None]
    assert bartlett_time([e], 0.2)[0] > 100


@pytest.mark.parametrize(("lengths", "correlation", "folds"), [([1600], 2.0, 16), ([600, 600], 25.0, 12), ([500], 100.0, 10), ([30] * 64, 1.0, 16)])
def test_blocks_cover_every_row_once_and_are_as_many_as_the_correlation_allows(lengths, correlation, folds):
    found = contiguous_blocks(lengths, correlation, GapSettings())
    rows = np.concatenate([found.rows(k) for k in range(found.folds)])
    assert found.folds == folds
    np.testing.assert_array_equal(np.sort(rows), np.arange(sum(lengths)))


def test_rows_beside_a_fold_stay_in_its_recording():
    found = contiguous_blocks([400, 400], 20.0, GapSettings(folds=10))
    first_of_second = int(found.fold[found.recording == 1][0])
    beside = found.neighbours(first_of_second)
    assert beside.min() >= 400
    assert len(beside) == found.apart


def test_fold_of_a_row_is_the_one_that_holds_it():
    found = contiguous_blocks([333, 500], 5.0, GapSettings())
    for recording, first, n in ((0, 0, 333), (1, 333, 500)):
        fold = found.fold_of(recording, np.arange(n))
        assert all(first + t in set(found.rows(int(k)).tolist()) for t, k in enumerate(fold))
