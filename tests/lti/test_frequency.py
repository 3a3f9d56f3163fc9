"""Frequency responses against direct solution, badly scaled and defective systems included."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing


def test_against_one_solve_at_a_time() -> None:
    rng = np.random.default_rng(0)
    s = StateSpace.of(rng.standard_normal((9, 9)), rng.standard_normal((9, 3)), rng.standard_normal((2, 9)), np.ones((2, 3)))
    omega = np.geomspace(0.01, 100, 50)
    found = frequency_response(s, omega)
    assert found.shape == (50, 2, 3)
    for w, value in zip(omega, found, strict=True):
        wanted = s.C @ np.linalg.solve(1j * w * np.eye(9) - s.A, s.B) + s.D
        assert np.abs(value - wanted).max() < 1e-11 * np.abs(wanted).max()


def exactly(A: np.ndarray, b: np.ndarray, w: float) -> np.ndarray:
    """Solve ``(j w I - A) x = b`` in rational numbers, as a real system of twice the size."""
    n = len(b)
    real = np.block([[-A, -w * np.eye(n)], [w * np.eye(n), -A]])
    rows = [[Fraction(float(v)) for v in row] + [Fraction(float(r))] for row, r in zip(real, [*b, *np.zeros(n)], strict=True)]
    for i in range(2 * n):
        pivot = next(k for k in range(i, 2 * n) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [v / rows[i][i] for v in rows[i]]
        for k in range(2 * n):
            if k != i and rows[k][i]:
                rows[k] = [a - rows[k][i] * c for a, c in zip(rows[k], rows[i], strict=True)]
    x = np.array([float(row[-1]) for row in rows])
    return x[:n] + 1j * x[n:]


def test_gas_bearing_against_exact_arithmetic() -> None:
    """Entries from 1 to 5e6 and two lightly damped modes."""
    s = gas_bearing().continuous()
    for w in (1.0, 62.0, 1340.0, 1e4):
        wanted = s.C @ exactly(s.A, s.B[:, 0], w)
        assert np.abs(frequency_response(s, w)[0, :, 0] - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_a_defective_system_has_no_eigenvectors_to_trip_over() -> None:
    n = 8
    s = StateSpace.of(-np.eye(n) + np.eye(n, k=1), np.eye(n)[:, [-1]], np.eye(n)[[0]])
    assert frequency_response(s, 2.0)[0, 0, 0] == pytest.approx(1 / (1 + 2j) ** n, rel=1e-12)


def test_discrete_static_and_empty() -> None:
    s = StateSpace.of([[0.5]], [[1.0]], [[1.0]], None, 0.1)
    assert frequency_response(s, [0.0, np.pi / 0.1])[:, 0, 0] == pytest.approx([2.0, -2 / 3])
    assert frequency_response(StateSpace.gain([[3.0]]), [1.0, 2.0])[:, 0, 0].tolist() == [3.0, 3.0]
    assert frequency_response(s, []).shape == (0, 1, 1)


def test_a_frequency_on_a_pole_and_nonsense_are_refused() -> None:
    integrator = StateSpace.of([[0.0]], [[1.0]], [[1.0]])
    with pytest.raises(IllConditioned, match="coincides with the pole"):
        frequency_response(integrator, [0.0])
    with pytest.raises(BadInput, match="finite numbers in rad/s"):
        frequency_response(integrator, [np.inf])
