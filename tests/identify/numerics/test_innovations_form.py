"""The innovations form: a predictor that is stable, of the same noise."""

import numpy as np

from afdsvc.identify.numerics.innovations_form import InnovationsForm, with_stable_predictor
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
