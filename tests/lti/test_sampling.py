"""Sampling of white noise on the states of a continuous system."""

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from afdsvc.lti.sampling import sample_noise


def test_sampled_noise_leaves_the_stationary_covariance_as_it_is():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((4, 4)) - 4 * np.eye(4)
    G = rng.standard_normal((4, 2))
    P = solve_continuous_lyapunov(A, -G @ G.T)
    step = expm(0.3 * A)
    assert np.allclose(step @ P @ step.T + sample_noise(A, G @ G.T, 0.3), P, rtol=1e-10, atol=1e-12)
