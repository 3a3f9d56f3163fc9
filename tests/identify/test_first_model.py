"""A first model: the numbers of a plant that is one lag or one resonance come back."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.identify.first_model import first_model
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.transfer_function import from_polynomials

DT = 5e-3


def _recorded(num, den, inputs, seed=2):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (150, inputs)), 40, axis=0)
    y = simulate(sample_zoh(from_polynomials([[[n] for n in num]], [[den] * inputs]), DT), u)[0][:, 0]
    return u, y + 0.02 * y.std() * rng.standard_normal(len(u))


def test_a_lag_with_two_inputs():
    found = first_model(*_recorded([12.0, -3.0], [0.08, 1.0], 2), DT, lag=True)
    np.testing.assert_allclose(found.num, [12.0, -3.0], rtol=0.02)
    np.testing.assert_allclose(found.den, [0.08, 1.0], rtol=0.02)
    assert found.r2 > 0.999


def test_a_resonance():
    den = [1 / 30.0**2, 2 * 0.1 / 30.0, 1.0]
    found = first_model(*_recorded([4.0], den, 1), DT, lag=False)
    np.testing.assert_allclose(found.num, [4.0], rtol=0.02)
    np.testing.assert_allclose(found.den, den, rtol=0.05)


@pytest.mark.parametrize("den", [[0.3, 1.0], [1 / 30.0**2, 2 * 0.1 / 30.0, 1.0]])
def test_without_a_unit_the_recording_tells_a_lag_from_a_resonance(den):
    found = first_model(*_recorded([4.0], den, 1), DT, lag=None)
    np.testing.assert_allclose(found.den, den, rtol=0.05)


def test_an_input_that_does_not_move_is_named():
    with pytest.raises(BadInput, match="does not move"):
        first_model(np.zeros((100, 1)), np.arange(100.0), DT, lag=True)
