"""The measures under their names, against the thesis' own figures."""

import json

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.stats.fit_measures import measures

# Published fits of the thesis' table 4.1 [%] and the coefficient of determination each of them means.
PUBLISHED = {76.76: 94.599, 83.58: 97.304, 51.36: 76.342, 3.19: 6.278}


@pytest.mark.parametrize(("fit", "classical"), PUBLISHED.items())
def test_published_fits_are_not_coefficients_of_determination(fit, classical):
    rng = np.random.default_rng(1)
    y = rng.standard_normal((1000, 1))
    error = rng.standard_normal((1000, 1))
    error *= (1 - fit / 100) * np.linalg.norm(y - y.mean()) / np.linalg.norm(error)
    found = measures(y, y + error)[0]
    assert 100 * found.r2 == pytest.approx(fit)
    assert 100 * found.r2_classical == pytest.approx(classical, abs=1e-3)
    assert found.nrmse == pytest.approx(1 - fit / 100)


def test_every_output_for_itself_and_offsets_do_not_count_as_movement():
    y = np.column_stack([np.sin(np.arange(100.0)), 50 + np.cos(np.arange(100.0))])
    perfect, mean = measures(y, np.column_stack([y[:, 0], np.full(100, y[:, 1].mean())]))
    assert (perfect.r2, mean.r2) == (1.0, pytest.approx(0.0))
    assert json.dumps(perfect.nrmse) == "0.0"


def test_an_output_that_does_not_move_and_wrong_shapes_are_named():
    with pytest.raises(BadInput, match="output 1 is constant over 10 samples"):
        measures(np.column_stack([np.arange(10.0), np.ones(10)]), np.zeros((10, 2)))
    with pytest.raises(BadInput, match="equal shapes"):
        measures(np.zeros((10, 2)), np.zeros((9, 2)))
