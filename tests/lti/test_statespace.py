"""Wiring systems together, checked at single frequencies, and what the constructor refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.scaling import balanced, rescale
from afdsvc.lti.stability import trim
from afdsvc.lti.statespace import StateSpace, block_diagonal, common_dt
from afdsvc.lti.yjbk import exchange
from afdsvc.plants.gas_bearing import gas_bearing

OMEGA = np.geomspace(0.1, 10, 7)


def system(seed: int, outputs: int, inputs: int, order: int = 3) -> StateSpace:
    rng = np.random.default_rng(seed)
    shapes = ((order, order), (order, inputs), (outputs, order), (outputs, inputs))
    return StateSpace.of(*(rng.standard_normal(s) for s in shapes))


def at(s: StateSpace) -> np.ndarray:
    return frequency_response(s, OMEGA)


def test_series_sum_inverse_selection() -> None:
    a, b, c = system(1, 2, 3), system(2, 3, 2), system(3, 2, 3)
    assert np.abs(at(a @ b) - at(a) @ at(b)).max() < 1e-10
    assert np.abs(at(a + c) - at(a) - at(c)).max() < 1e-10
    assert np.abs(at(a - c) - at(a) + at(c)).max() < 1e-10
    square = system(4, 2, 2)
    assert np.abs(at(square.inverse() @ square) - np.eye(2)).max() < 1e-9
    assert np.abs(at(a.select([1, 0], [2])) - at(a)[:, [1, 0], :][:, :, [2]]).max() < 1e-14
    both = at(block_diagonal(a, b))
    assert np.abs(both[:, :2, :3] - at(a)).max() < 1e-12
    assert np.abs(both[:, :2, 3:]).max() == 0


def test_exchange_solves_the_same_equations_the_other_way() -> None:
    s = system(5, 3, 4)
    solved = exchange(s, inputs=[1, 3], outputs=[0, 2])
    assert solved.order == s.order
    for g, h in zip(at(s), at(solved), strict=True):
        u = np.array([1.0, -2.0, 0.5, 3.0]) + 0j
        y = g @ u
        v, w = u.copy(), y.copy()
        v[[1, 3]], w[[0, 2]] = y[[0, 2]], u[[1, 3]]
        assert np.abs(h @ v - w).max() < 1e-9
    with pytest.raises(IllConditioned, match="singular"):
        exchange(StateSpace.of([[1.0]], [[1.0]], [[1.0]], [[0.0]]), [0], [0])


def test_trim_removes_only_what_zeros_disconnect() -> None:
    a, b = system(6, 2, 2), system(7, 2, 2)
    both = block_diagonal(a, b)
    assert trim(both.select([0, 1], [0, 1])).order == 3
    assert trim(both).order == 6
    assert np.abs(at(trim(both.select([2, 3], [2, 3]))) - at(b)).max() == 0


def test_scaling_is_exact_and_helps() -> None:
    """Powers of two: there and back gives the same bits; eigenvector condition of the gas bearing falls a hundredfold."""
    G = gas_bearing().continuous()
    scaled, t = balanced(G)
    back = rescale(scaled, 1 / t)
    assert np.array_equal(back.A, G.A)
    assert np.array_equal(np.log2(t), np.round(np.log2(t)))
    condition = [np.linalg.cond(np.linalg.eig(A)[1]) for A in (G.A, scaled.A)]
    assert condition[0] > 1000
    assert condition[1] < 100


def test_zero_order_hold_against_scipy_and_against_steps() -> None:
    G, dt = gas_bearing().continuous(), 2e-4
    found = sample_zoh(G, dt)
    A, B, C, D, _ = cont2discrete((G.A, G.B, G.C, G.D), dt)
    for name, wanted in zip("ABCD", (A, B, C, D), strict=True):
        assert np.abs(getattr(found, name) - wanted).max() <= 1e-12 * max(np.abs(wanted).max(), 1e-300)
    assert np.abs(found.A - expm(G.A * dt)).max() < 1e-12 * np.abs(found.A).max()
    integrator = StateSpace.of([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
    assert sample_zoh(integrator, 0.5).B[:, 0] == pytest.approx([0.125, 0.5], abs=1e-15)
    with pytest.raises(BadInput, match="discrete already"):
        sample_zoh(found, dt)
    with pytest.raises(BadInput, match="sample time 0 s"):
        sample_zoh(G, 0)


def test_shapes_and_numbers_are_named() -> None:
    with pytest.raises(BadInput, match=r"matrix A has shape \(2, 3\); expected a square matrix"):
        StateSpace.of(np.zeros((2, 3)), np.zeros((2, 1)), np.zeros((1, 2)))
    with pytest.raises(BadInput, match=r"matrix B has shape \(3, 1\); expected \(2, 1\)"):
        StateSpace.of(np.zeros((2, 2)), np.zeros((3, 1)), np.zeros((1, 2)))
    with pytest.raises(BadInput, match="matrix C contains NaN"):
        StateSpace.of([[0.0]], [[1.0]], [[np.nan]])
    with pytest.raises(BadInput, match="sample time -1"):
        StateSpace.of([[0.0]], [[1.0]], [[1.0]], None, -1)
    with pytest.raises(BadInput, match=r"sample times \[0.1, 0.2\] s cannot be joined"):
        common_dt(StateSpace.gain([[1.0]], 0.1), StateSpace.gain([[1.0]], 0.2))
    with pytest.raises(BadInput, match="series needs equal widths; 2 outputs meet 3 inputs"):
        _ = system(1, 2, 3) @ system(2, 2, 2)
    with pytest.raises(BadInput, match="only a square system has an inverse"):
        system(1, 2, 3).inverse()


def test_stability_margins() -> None:
    assert StateSpace.of([[0.9]], [[1.0]], [[1.0]], None, 0.1).stability_margin() == pytest.approx(0.1)
    assert StateSpace.of([[-3.0]], [[1.0]], [[1.0]]).stability_margin() == pytest.approx(3.0)
    assert StateSpace.gain([[1.0]]).stability_margin() == float("inf")
    assert not StateSpace.of([[0.0]], [[1.0]], [[1.0]]).is_stable()
