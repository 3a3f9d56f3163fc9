"""The innovations form: a predictor that is stable, of the same noise."""

import numpy as np
import pytest

from afdsvc.errors import IllConditioned
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors, with_stable_predictor
from afdsvc.lti.statespace import StateSpace

A = np.array([[0.9, 0.2], [-0.1, 0.7]])
C = np.array([[1.0, 0.0]])


def _spectrum(model):
    z = np.exp(1j * np.linspace(0, np.pi, 50))
    H = np.array([1 + (C @ np.linalg.solve(w * np.eye(2) - A, model.gain))[0, 0] for w in z])
    return np.abs(H) ** 2 * model.covariance[0, 0]


def _model(poles):
    """The gain that gives the predictor these poles."""
    from scipy.signal import place_poles

    return InnovationsForm(StateSpace(A, np.ones((2, 1)), C, np.zeros((1, 1)), 1.0), place_poles(A.T, C.T, poles).gain_matrix.T, np.array([[2.0]]))


def test_a_stable_predictor_is_kept():
    model = _model([0.5, 0.2])
    assert with_stable_predictor(model) is model


def test_an_unstable_predictor_becomes_that_of_the_same_noise():
    """Spectral factorisation: zeros outside the circle move to their mirror images, the spectrum stays."""
    model = _model([1.25, 0.2])
    found = with_stable_predictor(model)
    poles = np.sort(np.linalg.eigvals(A - found.gain @ C).real)
    np.testing.assert_allclose(poles, [0.2, 0.8], atol=1e-6)
    np.testing.assert_allclose(_spectrum(found), _spectrum(model), rtol=1e-6)


def test_prediction_errors_are_numbers_whatever_the_gain():
    """A predictor with a pole of modulus 3 would leave the range of numbers after 650 samples."""
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2000, 1)), rng.standard_normal((2000, 1))
    wild = _model([3.0, 0.2])
    np.testing.assert_allclose(wild.errors(u, y), with_stable_predictor(wild).errors(u, y))


def test_a_simulation_that_overflows_is_refused_with_its_pole():
    wild = StateSpace(np.array([[3.0]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 1.0)
    with pytest.raises(IllConditioned, match=r"pole 3 \(modulus 3, expected below 1\): it cannot run over 2000 samples"):
        fitted_errors(wild, np.ones((2000, 1)), np.ones((2000, 1)))
