"""Norms against numbers in closed form, dense frequency grids, and simulated noise."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.norms import largest_gain, output_covariance
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace


def drawn(seed: int, n: int, radius: float) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    return StateSpace.of(radius * A / np.abs(np.linalg.eigvals(A)).max(), rng.standard_normal((n, 2)), rng.standard_normal((3, n)), rng.standard_normal((3, 2)), 1.0)


@pytest.mark.parametrize(("seed", "n", "radius"), [(0, 1, 0.5), (1, 6, 0.98), (2, 25, 0.999), (3, 12, 0.3)])
def test_largest_gain_is_that_of_a_dense_grid(seed, n, radius):
    system = drawn(seed, n, radius)
    poles = np.abs(np.angle(system.poles()))
    grid = np.unique(np.concatenate([np.linspace(0, np.pi, 20_001), *(p + np.linspace(-0.01, 0.01, 2001) for p in poles)]))
    dense = np.linalg.norm(frequency_response(system, grid), 2, axis=(1, 2)).max()
    assert dense <= largest_gain(system) < 1.0005 * dense


def test_a_narrow_resonance_between_the_poles_of_the_first_grid_is_found():
    notch = StateSpace.of(np.diag([0.5, -0.5]), [[1.0], [1.0]], [[-1.0, 1.0]], [[0.1]], 1.0)
    dense = np.abs(frequency_response(notch, np.linspace(0, np.pi, 100_001))).max()
    assert dense <= largest_gain(notch) < 1.0005 * dense


def test_covariance_of_a_first_order_lag_and_of_simulated_noise():
    a = 0.9
    assert output_covariance(StateSpace.of([[a]], [[1.0]], [[2.0]], [[0.0]], 1.0))[0, 0] == pytest.approx(4 / (1 - a * a), rel=1e-12)
    system = drawn(4, 5, 0.8)
    y, _ = simulate(system, np.random.default_rng(0).standard_normal((400_000, 2)))
    assert np.cov(y.T) == pytest.approx(output_covariance(system), rel=0.05, abs=0.02 * float(np.var(y)))


def test_unstable_and_continuous_systems_are_refused():
    with pytest.raises(BadInput, match=r"pole 1\.1"):
        largest_gain(StateSpace.of([[1.1]], [[1.0]], [[1.0]], [[0.0]], 1.0))
    with pytest.raises(BadInput, match="continuous"):
        output_covariance(StateSpace.of([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
