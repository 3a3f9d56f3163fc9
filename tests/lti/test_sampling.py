"""From continuous to discrete time and back."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from afdsvc.lti.sampling import continuous, sample_noise, sample_zoh
from afdsvc.lti.statespace import StateSpace


def test_sampled_noise_leaves_the_stationary_covariance_as_it_is():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((4, 4)) - 4 * np.eye(4)
    G = rng.standard_normal((4, 2))
    P = solve_continuous_lyapunov(A, -G @ G.T)
    step = expm(0.3 * A)
    assert np.allclose(step @ P @ step.T + sample_noise(A, G @ G.T, 0.3), P, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("poles", [[-1.0, -7.0, -30.0], [-2 + 9j, -2 - 9j, 0.0], [-3.0, -3.0, 0.5], []])
def test_a_sampled_system_is_the_continuous_one_again(poles):
    rng, n = np.random.default_rng(7), len(poles)
    A = np.eye(n, k=1)
    A[-1:] = -np.real(np.atleast_1d(np.poly(poles)))[:0:-1]
    plant = StateSpace(A, rng.standard_normal((n, 2)), rng.standard_normal((1, n)), np.array([[0.5, -1.0]]))
    again = continuous(sample_zoh(plant, 0.05))
    assert all(np.allclose(getattr(again, name), getattr(plant, name), rtol=1e-6, atol=1e-6) for name in "ABCD")
    assert not again.discrete


@pytest.mark.parametrize("pole", [0.0, -0.5])
def test_a_pole_at_zero_or_on_the_negative_axis_has_no_continuous_system(pole):
    assert continuous(StateSpace(np.array([[pole]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 0.1)) is None
