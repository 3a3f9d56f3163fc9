"""Balanced truncation: error bounds, exact minimal realisations, both time bases, and the traps of other libraries."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import star
from afdsvc.lti.reduce import (
    balanced_truncation,
    closed_loop_truncation,
    hankel_singular_values,
    split_stable,
    weighted_truncation,
)
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import deviation_system, plant_from
from afdsvc.plants.gas_bearing import gas_bearing


def chain(dt: float) -> StateSpace:
    """Six masses in a row, force on the first, position of first and last: some modes matter little."""
    n = 6
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -0.3 * np.eye(n)]])
    B, C = np.zeros((2 * n, 1)), np.zeros((2, 2 * n))
    B[n], C[0, 0], C[1, n - 1] = 1.0, 1.0, 1.0
    system = StateSpace.of(A, B, C)
    return sample_zoh(system, dt) if dt else system


def grid(system: StateSpace) -> np.ndarray:
    return np.geomspace(1e-3, 0.99 * np.pi / system.dt if system.discrete else 1e3, 300)


def gain(system: StateSpace) -> float:
    return float(np.linalg.norm(frequency_response(system, grid(system)), 2, axis=(1, 2)).max())


@pytest.mark.parametrize("dt", [0.0, 0.2])
@pytest.mark.parametrize("order", [2, 4, 6, 8, 10])
def test_error_stays_within_twice_the_sum_of_the_tail(dt: float, order: int) -> None:
    system = chain(dt)
    found = balanced_truncation(system, order)
    assert found.system.order == order
    assert found.system.dt == dt
    assert found.bound == pytest.approx(2 * found.hankel[order:].sum())
    assert found.hankel[order] * 0.99 <= gain(system - found.system) <= found.bound


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_hankel_values_against_gramians_solved_as_linear_equations(dt: float) -> None:
    """Squares of the Hankel values are the eigenvalues of P Q, with P and Q from Kronecker products."""
    s = chain(dt)
    n, eye = s.order, np.eye(s.order)
    operator = np.kron(s.A, s.A) - np.eye(n * n) if dt else np.kron(s.A, eye) + np.kron(eye, s.A)
    P = np.linalg.solve(operator, -(s.B @ s.B.T).ravel()).reshape(n, n)
    dual = np.kron(s.A.T, s.A.T) - np.eye(n * n) if dt else np.kron(s.A.T, eye) + np.kron(eye, s.A.T)
    Q = np.linalg.solve(dual, -(s.C.T @ s.C).ravel()).reshape(n, n)
    wanted = np.sqrt(np.sort(np.linalg.eigvals(P @ Q).real)[::-1])
    assert np.abs(hankel_singular_values(s) - wanted).max() < 1e-9


def test_discrete_systems_are_really_reduced() -> None:
    """The bilinear image of a continuous system has the same Hankel values, and no library call may ignore dt."""
    system = chain(0.0)
    a = 10.0
    inverse = np.linalg.inv(a * np.eye(12) - system.A)
    image = StateSpace.of(
        inverse @ (a * np.eye(12) + system.A),
        np.sqrt(2 * a) * inverse @ system.B,
        np.sqrt(2 * a) * system.C @ inverse,
        system.C @ inverse @ system.B,
        0.1,
    )
    assert np.abs(hankel_singular_values(image) - hankel_singular_values(system)).max() < 1e-10
    assert balanced_truncation(image, 4).system.order == 4


def test_a_plant_comes_back_from_its_deviation() -> None:
    """G -> S -> G(S) has hidden modes of the loop; truncation to the plant's order returns the plant (gas bearing)."""
    p = gas_bearing()
    G, true = p.discrete(), p.discrete(stiffness_hh=-1.7e6, gain_vv=4.5e6)
    F = lqr(G, 1e-4 * np.diag([0, 0, 1, 1, 0, 0]), np.eye(2))
    f = observer_factorisation(G, F, kalman_predictor_gain(G, 0.01 * np.eye(6), np.eye(2)))
    back = plant_from(f, deviation_system(f, true))
    assert back.order == 18
    small = balanced_truncation(back, 6).system
    wanted = frequency_response(true, grid(true))
    assert np.abs(frequency_response(small, grid(true)) - wanted).max() < 1e-10 * np.abs(wanted).max()


def test_tolerance_finds_the_minimal_order() -> None:
    system = chain(0.2)
    padded = system + StateSpace(system.A, 0 * system.B, system.C, system.D, system.dt)
    assert padded.order == 24
    assert balanced_truncation(padded).system.order == balanced_truncation(system).system.order


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_unstable_modes_are_kept(dt: float) -> None:
    system = chain(dt)
    pole = 1.3 if dt else 0.4
    unstable = StateSpace.of([[pole]], [[1.0]], [[0.5], [0.1]], None, dt)
    joint = system + unstable
    stable, rest = split_stable(joint)
    assert rest.order == 1
    assert stable.is_stable()
    found = balanced_truncation(joint, 7)
    assert np.abs(found.system.poles() - pole).min() < 1e-9
    assert gain(joint - found.system) <= found.bound
    with pytest.raises(BadInput, match=r"order 0 is not possible; from 1 \(the unstable modes\) to 13 is"):
        balanced_truncation(joint, 0)


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_stable_and_unstable_parts_add_up(dt: float) -> None:
    """Modes coupled through a full A: the Sylvester equation has something to do."""
    rng = np.random.default_rng(5)
    A = rng.standard_normal((7, 7))
    A *= 1.4 / np.abs(np.linalg.eigvals(A)).max()
    system = StateSpace.of(A, rng.standard_normal((7, 2)), rng.standard_normal((3, 7)), rng.standard_normal((3, 2)), dt)
    stable, rest = split_stable(system)
    assert stable.order + rest.order == 7
    assert stable.is_stable()
    assert 0 < rest.order < 7
    assert min(abs(p) if dt else p.real for p in rest.poles()) > (1 if dt else 0)
    wanted = frequency_response(system, grid(system))
    both = frequency_response(stable, grid(system)) + frequency_response(rest, grid(system))
    assert np.abs(both - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_weights_move_the_error_where_it_does_not_matter() -> None:
    system = chain(0.0)
    low_pass = StateSpace.of([[-0.2]], [[0.2]], [[1.0]])
    weight = StateSpace.of(np.diag([-0.2, -0.2]), 0.2 * np.eye(2), np.eye(2))
    plain, weighted = balanced_truncation(system, 4).system, weighted_truncation(system, 4, weight, low_pass).system
    for found in (plain, weighted):
        assert found.order == 4
    assert gain(weight @ (system - weighted) @ low_pass) < 0.7 * gain(weight @ (system - plain) @ low_pass)


def test_closed_loop_reduction_keeps_the_loop() -> None:
    """Two slow modes the loop suppresses and one it does not: twenty times less change of the loop at order 3."""
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = np.diag([-0.1, -0.4]), [[0.0, 5.0], [-5.0, -0.5]]
    system = StateSpace.of(A, [[1.0], [1.0], [0.0], [1.0]], [[1.0, 0.5, 0.0, 0.6]])
    controller = StateSpace.of([[-2.0]], [[1.0]], [[-6.0]])
    reduced = closed_loop_truncation(system, controller, 3).system
    plain = balanced_truncation(system, 3).system

    def closed(plant: StateSpace) -> StateSpace:
        both = StateSpace(plant.A, np.hstack([plant.B, plant.B]), np.vstack([plant.C, plant.C]), np.zeros((2, 2)), 0.0)
        return star(both, controller, 1, 1)

    assert gain(closed(system) - closed(reduced)) < 0.05 * gain(closed(system) - closed(plain))


def test_orders_and_unstable_inputs_are_refused() -> None:
    with pytest.raises(BadInput, match="order 13 is not possible"):
        balanced_truncation(chain(0.2), 13)
    with pytest.raises(BadInput, match=r"the system has the pole 2.*Hankel"):
        hankel_singular_values(StateSpace.of([[2.0]], [[1.0]], [[1.0]], None, 0.1))
    with pytest.raises(BadInput, match="output weight"):
        weighted_truncation(chain(0.0), 4, StateSpace.of([[1.0]], [[1.0, 1.0]], [[1.0]]))
