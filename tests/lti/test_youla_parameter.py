"""Q that realises a controller, and J_K with Q in place, for drawn plants and controllers (hypothesis)."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.lti.coprime import controller_factorisation, observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.stability import is_stable
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import interconnection, retuned_interconnection, youla_parameter
from afdsvc.plants.examples import random_stable
from afdsvc.plugins.controllers.lqg import lqg_gains

FREQUENCIES = np.geomspace(1e-3, 0.99, 30) * np.pi / 1e-3


def drawn(seed: int, observer: bool) -> tuple[StateSpace, StateSpace, StateSpace]:
    """Return a plant of 2 x 2 signals, J_K of a running controller, and another controller, which need not hold the plant."""
    rng = np.random.default_rng(seed)
    plant, _ = random_stable(rng, order=int(rng.integers(1, 6)), dt=1e-3)
    F, L = lqg_gains(plant, {"input_weight": float(rng.uniform(0.1, 10))})
    if observer:
        fact = observer_factorisation(plant, F, L)
    else:
        fact = controller_factorisation(plant, observer_factorisation(plant, 0.5 * F, L).K)
    n = int(rng.integers(0, 5))
    A = rng.standard_normal((n, n)) / max(n, 1)
    K = StateSpace(A, rng.standard_normal((n, 2)), 0.1 * rng.standard_normal((2, n)), 0.1 * rng.standard_normal((2, 2)), 1e-3)
    return plant, interconnection(fact), K


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), observer=st.booleans())
def test_the_controller_with_q_is_the_controller_asked_for(seed, observer):
    plant, J, K = drawn(seed, observer)
    Q = youla_parameter(J, K)
    again, expected = frequency_response(star(J, Q, 2, 2), FREQUENCIES), frequency_response(K, FREQUENCIES)
    assert np.abs(again - expected).max() < 1e-8 * max(1.0, float(np.abs(expected).max()))
    assert is_stable(Q.A, Q.dt) == is_stable(star(plant, K, 2, 2).A, plant.dt)  # Q is stable exactly when K holds the plant


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), gain=st.floats(0, 1))
def test_a_healthy_machine_keeps_its_residual_with_any_stable_q(seed, gain):
    rng = np.random.default_rng(seed)
    plant, J, _ = drawn(seed, True)
    Q = StateSpace(np.diag([0.5, -0.3]), rng.standard_normal((2, 2)), rng.standard_normal((2, 2)), rng.standard_normal((2, 2)), 1e-3)
    both = retuned_interconnection(J, Q, gain)
    loop = star(plant, both, 2, 2)
    assert is_stable(loop.A, plant.dt)
    assert np.abs(frequency_response(loop, FREQUENCIES)).max() < 1e-8  # S = 0: alpha does not reach beta
    alone = star(J, StateSpace.gain(np.zeros((2, 2)), 1e-3), 2, 2)
    if gain == 0:
        assert np.allclose(frequency_response(both.select([0, 1], [0, 1]), FREQUENCIES), frequency_response(alone, FREQUENCIES))
