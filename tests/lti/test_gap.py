"""The nu-gap: against frequency gridding, a closed form, unstable plants, and the theorem it is used for."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.gap import graph, nu_gap, stability_margin
from afdsvc.lti.stability import closed_loop_matrix
from afdsvc.lti.statespace import StateSpace
from afdsvc.testing.machines import bearing_problem


def pointwise(one, other, count=20_000):
    """Return the largest chordal distance on a grid, from the definition."""
    w = np.concatenate([[0.0], np.geomspace(1e-5, np.pi, count)]) / one.dt
    a, b = frequency_response(one, w), frequency_response(other, w)

    def root(M):
        values, vectors = np.linalg.eigh(M)
        return (vectors / np.sqrt(values)[:, None, :]) @ np.conj(np.swapaxes(vectors, 1, 2))

    def star(M):
        return np.conj(np.swapaxes(M, 1, 2))

    left, right = root(np.eye(b.shape[1]) + b @ star(b)), root(np.eye(a.shape[2]) + star(a) @ a)
    return float(np.linalg.norm(left @ (a - b) @ right, 2, axis=(1, 2)).max())


def test_factors_are_normalised():
    G = bearing_problem("proportional").plant
    at = frequency_response(graph(G), np.geomspace(1, 15_000, 50))
    np.testing.assert_allclose(np.conj(np.swapaxes(at, 1, 2)) @ at, np.broadcast_to(np.eye(2), (50, 2, 2)), atol=1e-9)
    np.testing.assert_allclose(at[:, :2] @ np.linalg.inv(at[:, 2:]), frequency_response(G, np.geomspace(1, 15_000, 50)), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("severity", [-0.01, -0.1, -0.5, -1.0])
def test_gap_of_a_fault_is_the_largest_distance_over_frequency(severity):
    problem = bearing_problem("proportional")
    faulty = problem.augmented.close({"horizontal_actuator": severity})
    found = nu_gap(problem.plant, faulty)
    assert found == pytest.approx(pointwise(problem.plant, faulty), rel=2e-3)
    assert found == pytest.approx(nu_gap(faulty, problem.plant), rel=1e-3)


def test_no_controller_takes_one_integrator_for_its_negative():
    plant = StateSpace.of([[1.0]], [[1.0]], [[1.0]], None, 0.1)
    assert nu_gap(plant, -plant) == 1.0
    assert nu_gap(plant, StateSpace.of([[1.02]], [[1.0]], [[1.0]], None, 0.1)) < 0.1  # stable or not does not matter
    assert nu_gap(StateSpace.of([[0.5]], [[1.0]], [[1.0]], None, 0.1), StateSpace.of([[1.5]], [[1.0]], [[-1.0]], None, 0.1)) == 1.0


def test_a_gap_below_the_margin_leaves_every_loop_stable():
    rng, tried, broken = np.random.default_rng(3), 0, 0
    while tried < 40:
        A = rng.normal(size=(3, 3))
        G = StateSpace.of(A * rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(A)).max(), rng.normal(size=(3, 1)), rng.normal(size=(1, 3)), None, 1.0)
        K = StateSpace.gain([[rng.normal()]], 1.0)
        if np.abs(np.linalg.eigvals(closed_loop_matrix(G, K))).max() >= 0.999:
            continue
        tried, margin = tried + 1, stability_margin(G, K)
        for _ in range(5):
            other = StateSpace.of(G.A * rng.uniform(0.7, 1.3), G.B, G.C * rng.uniform(0.5, 1.5), None, 1.0)
            stable = np.abs(np.linalg.eigvals(closed_loop_matrix(other, K))).max() < 1
            broken += not stable
            if nu_gap(G, other) < margin:
                assert stable
    assert broken > 5


def test_bad_input_is_one_sentence():
    with pytest.raises(BadInput, match="same shape"):
        nu_gap(StateSpace.gain(np.eye(2), 1.0), StateSpace.gain([[1.0]], 1.0))
    with pytest.raises(BadInput, match="discrete"):
        graph(StateSpace.of([[-1.0]], [[1.0]], [[1.0]], None, 0.0))
