"""Riccati solutions against python-control, their own equation, and the traps they must refuse."""

from __future__ import annotations

import control
import numpy as np
import pytest

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.riccati import kalman_predictor_gain, lqr, riccati
from afdsvc.lti.statespace import StateSpace


def plant(dt: float) -> StateSpace:
    rng = np.random.default_rng(1)
    A = rng.standard_normal((5, 5))
    A *= 1.2 / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace.of(A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), None, dt)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_gains_against_python_control(dt: float) -> None:
    G = plant(dt)
    Q, R, S = np.diag([1.0, 2, 3, 4, 5]), np.diag([0.5, 2.0]), 0.1 * np.ones((5, 2))
    design = control.dlqr if dt else control.lqr
    assert np.abs(lqr(G, Q, R, S) + design(G.A, G.B, Q, R, S)[0]).max() < 1e-9
    Rv = np.diag([0.1, 0.2, 0.3])
    L = kalman_predictor_gain(G, Q, Rv)
    assert np.abs(L + design(G.A.T, G.C.T, Q, Rv)[0].T).max() < 1e-9
    assert StateSpace(G.A + L @ G.C, G.B, G.C, G.D, dt).is_stable()


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_answers_come_in_the_units_of_the_caller(dt: float) -> None:
    """Scaling states by 1e-6 to 1e6 scales the gain and nothing else."""
    G, units = plant(dt), 10.0 ** np.array([-6, 6, -3, 3, 0])
    scaled = StateSpace.of(G.A * units[:, None] / units, G.B * units[:, None], G.C / units, None, dt)
    wanted = lqr(G, np.eye(5), np.eye(2))
    found = lqr(scaled, np.diag(units**-2.0), np.eye(2)) * units
    assert np.abs(found - wanted).max() < 1e-9


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_solution_satisfies_its_equation(dt: float) -> None:
    G = plant(dt)
    Q, R, S = np.eye(5), np.eye(2), 0.2 * np.ones((5, 2))
    X, F = riccati(G.A, G.B, Q, R, S, dt)
    closed = G.A + G.B @ F
    cost = Q + F.T @ R @ F + S @ F + F.T @ S.T
    residual = closed.T @ X @ closed - X + cost if dt else closed.T @ X + X @ closed + cost
    assert np.abs(residual).max() < 1e-9 * np.abs(X).max()


@pytest.mark.parametrize(("A", "dt"), [([[1.0]], 0.1), ([[0.0]], 0.0)])
def test_border_of_stability_without_weight_is_refused_not_silently_wrong(A: list[list[float]], dt: float) -> None:
    G = StateSpace.of(A, [[1.0]], [[1.0]], None, dt)
    with pytest.raises(IllConditioned, match="no stabilising solution"):
        lqr(G, 0.0, 1.0)


def test_unreachable_unstable_mode_is_refused() -> None:
    G = StateSpace.of(np.diag([1.5, 0.5]), [[0.0], [1.0]], [[1.0, 1.0]], None, 0.1)
    with pytest.raises(IllConditioned, match="no stabilising solution"):
        lqr(G, np.eye(2), 1.0)


def test_bad_weights_are_named() -> None:
    G = plant(0.1)
    with pytest.raises(BadInput, match=r"Q has shape \(2, 2\); expected a finite matrix of shape \(5, 5\)"):
        lqr(G, np.eye(2), np.eye(2))
    with pytest.raises(BadInput, match="R is singular"):
        lqr(G, np.eye(5), np.zeros((2, 2)))
    with pytest.raises(BadInput, match="positive semidefinite"):
        kalman_predictor_gain(G, -np.eye(5), np.eye(3))


def test_a_static_plant_needs_no_gain() -> None:
    assert lqr(StateSpace.gain([[1.0]], 0.1), np.zeros((0, 0)), 1.0).shape == (1, 0)
