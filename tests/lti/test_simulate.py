"""Running systems over samples: the same bits however it is cut, with and without numba."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import dlsim

from afdsvc.errors import BadInput
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace


def system(seed: int, order: int = 6) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((order, order))
    A *= 0.99 / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace.of(A, rng.standard_normal((order, 2)), rng.standard_normal((3, order)), rng.standard_normal((3, 2)), 0.01)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 100), cuts=st.lists(st.integers(0, 500), max_size=12))
def test_blocks_give_the_bits_of_the_whole(seed: int, cuts: list[int]) -> None:
    s, u = system(seed), np.random.default_rng(seed).standard_normal((500, 2))
    whole, end = simulate(s, u)
    x, parts = None, []
    for start, stop in zip([0, *sorted(cuts)], [*sorted(cuts), 500], strict=True):
        y, x = simulate(s, u[start:stop], x)
        parts.append(y)
    assert np.array_equal(np.vstack(parts), whole)
    assert np.array_equal(x, end)


def simulate_numpy(system: StateSpace, u: np.ndarray, x0: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return what `simulate` returns, to the last bit, without numba (some forty times slower)."""
    x = np.zeros(system.order) if x0 is None else x0
    A, B, C, D = system.A.T, system.B.T, system.C.T, system.D.T
    y = np.zeros((u.shape[0], system.outputs))
    for k in range(u.shape[0]):
        after = np.zeros_like(x)
        for j in range(x.size):
            y[k] += C[j] * x[j]
            after += A[j] * x[j]
        for j in range(u.shape[1]):
            y[k] += D[j] * u[k, j]
            after += B[j] * u[k, j]
        x = after
    return y, x


@pytest.mark.parametrize("seed", range(5))
def test_numba_and_numpy_give_the_same_bits(seed: int) -> None:
    s, rng = system(seed), np.random.default_rng(seed)
    u, x0 = rng.standard_normal((200, 2)), rng.standard_normal(6)
    fast, slow = simulate(s, u, x0), simulate_numpy(s, u, x0)
    assert np.array_equal(fast[0], slow[0])
    assert np.array_equal(fast[1], slow[1])


def test_against_scipy() -> None:
    s, u = system(1), np.random.default_rng(2).standard_normal((300, 2))
    _, wanted, _ = dlsim((s.A, s.B, s.C, s.D, s.dt), u)
    assert np.abs(simulate(s, u)[0] - wanted).max() < 1e-11


def test_start_is_not_modified_and_static_gains_run() -> None:
    s, x0 = system(3), np.ones(6)
    simulate(s, np.ones((10, 2)), x0)
    assert np.array_equal(x0, np.ones(6))
    y, x = simulate(StateSpace.gain([[2.0, 1.0]]), np.array([[1.0, 3.0], [0.0, 1.0]]))
    assert y.tolist() == [[5.0], [1.0]]
    assert x.shape == (0,)


def test_wrong_shapes_and_continuous_systems_are_refused() -> None:
    with pytest.raises(BadInput, match=r"inputs of shape \(5, 3\); expected \(samples, 2\)"):
        simulate(system(1), np.zeros((5, 3)))
    with pytest.raises(BadInput, match=r"initial state of shape \(2,\); expected \(6,\)"):
        simulate(system(1), np.zeros((5, 2)), np.zeros(2))
    with pytest.raises(BadInput, match="sample it with"):
        simulate(StateSpace.of([[-1.0]], [[1.0]], [[1.0]]), np.zeros((5, 1)))
