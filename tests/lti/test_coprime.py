"""Orders, refusals and the less usual ways to factorise; the identities themselves are in test_identities."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput, IllConditioned, NotStabilising
from afdsvc.lti.conditioning import amplification, identity_residual
from afdsvc.lti.coprime import (
    controller_factorisation,
    observer_factorisation,
    observer_form,
    proportional_factorisation,
    stable_controller_factorisation,
)
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.stabilise import gain_with_margin
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import controller_from, interconnection, plant_from
from afdsvc.plants.examples import unstable_second_order
from afdsvc.plants.gas_bearing import gas_bearing

OMEGA = np.linspace(0.01, 3.1, 15)


def plant(feedthrough: bool = True) -> StateSpace:
    rng = np.random.default_rng(8)
    A = rng.standard_normal((4, 4))
    A *= 1.1 / np.abs(np.linalg.eigvals(A)).max()
    D = 0.4 * rng.standard_normal((3, 2)) if feedthrough else np.zeros((3, 2))
    return StateSpace.of(A, rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), D, 1.0)


def gains(G: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    return lqr(G, np.eye(4), np.eye(2)), kalman_predictor_gain(G, np.eye(4), np.eye(3))


def test_order_of_j_k() -> None:
    """n for an observer, n + n_K in general, n + 2 n_K for a stable controller given as transfer functions."""
    G = plant()
    f = observer_factorisation(G, *gains(G))
    assert interconnection(f).order == 4
    Q = StateSpace.of([[0.3]], 0.1 * np.ones((1, 3)), 0.1 * np.ones((2, 1)), None, 1.0)
    K = controller_from(f, Q)
    assert K.order == 5
    assert interconnection(controller_factorisation(G, K)).order == 9
    stable = gas_bearing().discrete()
    slow = StateSpace.of(0.5 * np.eye(2), np.eye(2), 0.05 * np.eye(2), None, 2e-4)
    assert interconnection(stable_controller_factorisation(stable, slow)).order == 6 + 2 * 2


@pytest.mark.parametrize("feedthrough", [False, True])
def test_observer_form_recovers_an_observer_with_a_static_youla_term(feedthrough: bool) -> None:
    G = plant(feedthrough)
    f = observer_factorisation(G, *gains(G))
    K = controller_from(f, StateSpace.gain(0.1 * np.arange(6.0).reshape(2, 3), 1.0))
    found = observer_form(G, K)
    J = interconnection(found)
    assert J.order == 4
    assert np.abs(frequency_response(J, OMEGA)[:, :2, :3] - frequency_response(K, OMEGA)).max() < 1e-10
    assert factorise(G, K).R.order == 4


def test_observer_form_of_a_controller_designed_by_somebody_else() -> None:
    """Any order-n stabilising controller, here a lead compensator, not only LQG."""
    G = StateSpace.of([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    K = StateSpace.of([[-10.0, 0.0], [1.0, -20.0]], [[1.0], [0.0]], [[120.0, 40.0]], [[-16.0]])
    f = observer_form(G, K)
    assert interconnection(f).order == 2
    J = frequency_response(interconnection(f), OMEGA)
    assert np.abs(J[:, :1, :1] - frequency_response(K, OMEGA)).max() < 1e-9


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_observer_form_is_found_when_there_are_too_many_halves_to_try(dt: float) -> None:
    """Order 14: forty million halves; neighbours in a few orders suffice."""
    for seed in range(4):
        rng, n = np.random.default_rng(seed), 14
        A = rng.standard_normal((n, n))
        A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
        A = A if dt else 5 * (A - np.eye(n))
        G = StateSpace.of(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), None, dt)
        F, L = lqr(G, 0.1 * np.eye(n), np.eye(2)), kalman_predictor_gain(G, 0.1 * np.eye(n), np.eye(2))
        K = StateSpace(G.A + G.B @ F + L @ G.C, -L, F, np.zeros((2, 2)), dt)
        assert observer_form(G, K).R.order == n


def test_plants_without_a_real_half_fall_back_to_the_general_form() -> None:
    """A first-order plant whose loop has a complex pair: no real observer of order 1 exists."""
    G = StateSpace.of([[0.5]], [[1.0]], [[1.0]], None, 1.0)
    K = StateSpace.of([[0.5]], [[1.0]], [[-0.3]], None, 1.0)
    with pytest.raises(IllConditioned, match="no well-conditioned observer form"):
        observer_form(G, K)
    assert factorise(G, K).R.order == 2


def test_default_gain_of_a_static_controller_makes_v_the_identity() -> None:
    G = gas_bearing().discrete()
    f = proportional_factorisation(G, 0.2)
    for factor in (f.V, f.Vt):
        assert factor.order == 0
        assert np.array_equal(factor.D, np.eye(2))


def test_default_gain_with_feedthrough() -> None:
    """``V = I``, ``Vt = (I - P D)^-1`` and ``M = (I - P G)^-1 (I - P D)``."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((4, 4))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    G = StateSpace.of(A, rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), 1.0)
    P = 0.1 * rng.standard_normal((2, 3))
    f, g = proportional_factorisation(G, P), frequency_response(G, OMEGA)
    assert f.V.order == 0
    keep = np.eye(2) - P @ G.D
    assert np.abs(frequency_response(f.Vt, OMEGA) - np.linalg.inv(keep)).max() < 1e-12
    assert np.abs(frequency_response(f.M, OMEGA) - np.linalg.inv(np.eye(2) - P @ g) @ keep).max() < 1e-11


def test_signs_of_thesis_2_28_to_2_33_as_corrected() -> None:
    """With M = (I + K G)^-1 as printed the Bezout identity misses by more than one; with (I - K G)^-1 it holds."""
    G = gas_bearing().discrete()
    K = StateSpace.of(0.5 * np.eye(2), np.eye(2), 0.05 * np.eye(2), None, 2e-4)
    f = stable_controller_factorisation(G, K)
    g, k = frequency_response(G, [62.0])[0], frequency_response(K, [62.0])[0]
    right, printed = np.linalg.inv(np.eye(2) - k @ g), np.linalg.inv(np.eye(2) + k @ g)
    assert np.abs(frequency_response(f.M, [62.0])[0] - right).max() < 1e-10
    assert np.abs(right - k @ g @ right - np.eye(2)).max() < 1e-12
    assert np.abs(printed - k @ g @ printed - np.eye(2)).max() > 0.2


def test_cheapest_gain_moves_only_what_lacks_the_margin() -> None:
    A = np.diag([1.25, 0.9, 0.2])
    F = gain_with_margin(A, np.ones((3, 1)), 1.0, 0.05)
    poles = np.sort(np.linalg.eigvals(A + np.ones((3, 1)) @ F).real)
    assert poles == pytest.approx([0.2, 0.95**2 / 1.25, 0.9], abs=1e-9)
    units = np.array([1e3, 1e-5])  # of two equal inputs: each does half the work in its own unit
    two = gain_with_margin(A, np.ones((3, 2)) * units, 1.0, 0.05) * units[:, None]
    assert two[0] == pytest.approx(two[1], rel=1e-9)
    assert not gain_with_margin(A[1:, 1:], np.ones((2, 1)), 1.0, 0.05).any()
    with pytest.raises(IllConditioned, match="cannot be reached"):
        gain_with_margin(A, np.array([[0.0], [1.0], [1.0]]), 1.0, 0.05)


def test_default_gains_keep_half_the_margin_of_the_loop() -> None:
    """A double integrator under a lead: the fictitious state feedback is at least half as fast as the loop."""
    G = StateSpace.of([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    K = StateSpace.of([[-20.0]], [[1.0]], [[300.0]], [[-17.0]])
    f = controller_factorisation(G, K)
    loop = f.Lf.stability_margin()
    assert f.R.stability_margin() > 0.49 * loop > 0


def test_unstable_gains_are_refused_with_their_pole() -> None:
    G = unstable_second_order().discrete()
    F, L = np.array([[-0.4236, 0.1252]]), np.array([[0.2258], [-0.1229]])
    observer_factorisation(G, F, L)
    with pytest.raises(BadInput, match=r"A \+ B F has the pole 1\.15.*choose another state feedback F"):
        observer_factorisation(G, 0 * F, L)
    with pytest.raises(BadInput, match=r"A \+ L C has the pole 1\.15"):
        observer_factorisation(G, F, 0 * L)
    with pytest.raises(BadInput, match=r"gain F has shape \(2, 1\); expected a finite matrix of shape \(1, 2\)"):
        observer_factorisation(G, F.T, L)


def test_proportional_gain_of_the_wrong_sign_is_named() -> None:
    """P5 prints K = -0.2, which does not stabilise Table 0.1; +0.2 does."""
    with pytest.raises(NotStabilising, match=r"modulus 1\.00936"):
        proportional_factorisation(gas_bearing().discrete(), -0.2)


def test_unstable_controller_needs_the_general_form() -> None:
    """A static Youla term makes an unstable controller that stabilises; only the transfer-function way refuses it."""
    G = plant()
    f = observer_factorisation(G, *gains(G))
    controllers = (controller_from(f, StateSpace.gain(q * np.ones((2, 3)), 1.0)) for q in (1.0, -1.0, 3.0, -3.0))
    K = next(K for K in controllers if not K.is_stable())
    with pytest.raises(BadInput, match=r"the controller has the pole .*use controller_factorisation"):
        stable_controller_factorisation(G, K)
    general = controller_factorisation(G, K)
    assert general.R.is_stable()
    assert (
        np.abs(frequency_response(general.U, OMEGA) - frequency_response(K, OMEGA) @ frequency_response(general.V, OMEGA)).max()
        < 1e-9
    )


def test_only_stable_q_and_s_are_taken() -> None:
    G = plant()
    f = observer_factorisation(G, *gains(G))
    unstable = StateSpace.of([[1.5]], np.ones((1, 3)), np.ones((2, 1)), None, 1.0)
    with pytest.raises(BadInput, match=r"Q has the pole 1\.5"):
        controller_from(f, unstable)
    with pytest.raises(BadInput, match="S has 2 outputs and 3 inputs; expected 3 and 2"):
        plant_from(f, unstable)


def test_ill_conditioned_factors_are_refused_with_both_numbers() -> None:
    """Eight unstable poles held by one input: rounding would reach the third digit of the identity."""
    G = StateSpace.of(np.diag(np.arange(1.0, 9.0)), np.ones((8, 1)), np.ones((1, 8)))
    F = lqr(G, np.eye(8), 1.0)
    with pytest.raises(IllConditioned, match=r"holds only to .*\(expected below 1e-10\): rounding is amplified .* times"):
        observer_factorisation(G, F, F.T)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("unstable", [2, 4, 6, 8])
def test_amplification_predicts_the_residual(unstable: int, dt: float) -> None:
    """Over eighteen orders of magnitude the residual is 1e-3 to 0.1 of amplification times 1.1e-16."""
    s = np.arange(1.0, unstable + 1)
    G = StateSpace.of(np.diag(np.exp(dt * s) if dt else s), np.ones((unstable, 1)), np.ones((1, unstable)), None, dt)
    F = lqr(G, np.eye(unstable), 1.0)
    R = StateSpace(G.A + G.B @ F, np.hstack([G.B, -F.T]), np.vstack([F, G.C]), np.eye(2), dt)
    Lf = StateSpace(G.A + F.T @ G.C, np.hstack([-G.B, F.T]), np.vstack([F, G.C]), np.eye(2), dt)
    ratio = identity_residual(R, Lf) / (1.1e-16 * amplification(R, Lf))
    assert 1e-3 < ratio < 0.1


def test_conditioning_numbers_do_not_depend_on_units() -> None:
    G = plant()
    units, inputs, outputs = 10.0 ** np.array([-3, 4, 0, 2]), np.array([1e3, 1e-2]), np.array([1e-4, 1.0, 1e5])
    F, L = gains(G)
    scaled = StateSpace(
        G.A * units[:, None] / units,
        G.B * units[:, None] * inputs,
        outputs[:, None] * G.C / units,
        outputs[:, None] * G.D * inputs,
        1.0,
    )
    a = observer_factorisation(G, F, L)
    b = observer_factorisation(scaled, F / inputs[:, None] / units, units[:, None] * L / outputs)
    assert amplification(b.R, b.Lf) == pytest.approx(amplification(a.R, a.Lf), rel=2.0)
    assert identity_residual(b.R, b.Lf) < 1e-12
    assert identity_residual(a.R, a.Lf) < 1e-12
