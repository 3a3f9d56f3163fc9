import numpy as np
import pytest

from afdsvc.explain.gap.features import first_order_lag, level, mode_pole, poles, resonate, shifted
from afdsvc.explain.gap.signals import ResidualSignals


def test_a_lag_holds_the_first_value():
    np.testing.assert_array_equal(shifted(np.array([1.0, 2, 3, 4]), 2), [1, 1, 1, 2])
    np.testing.assert_array_equal(shifted(np.array([1.0, 2]), 5), [1, 1])


def test_a_low_pass_starts_settled_and_ends_at_the_level():
    np.testing.assert_allclose(first_order_lag(np.full(50, 3.0), 10.0), 3.0)
    assert first_order_lag(np.r_[np.zeros(5), np.ones(200)], 10.0)[-1] == pytest.approx(1.0, abs=1e-6)


def test_level_follows_the_size_of_an_oscillation():
    x = np.r_[np.zeros(500), np.sin(np.arange(3000))]
    assert level(x, 100.0)[-1, 0] == pytest.approx(2 / np.pi, rel=0.05)


def test_a_resonator_rings_at_its_frequency():
    x = np.zeros(400)
    x[0] = 1.0
    out = resonate(x - x.mean(), mode_pole(0.05, 0.01))[:, 1]
    assert np.argmax(np.abs(np.fft.rfft(out))) == 20


def test_poles_of_a_simulation_are_found_from_its_states():
    rng = np.random.default_rng(1)
    A, B = np.array([[0.99, 0.05], [-0.08, 0.97]]), np.array([0.0, 0.1])
    u, x = rng.normal(size=(2000, 1)), np.zeros((2000, 2))
    for t in range(1999):
        x[t + 1] = A @ x[t] + B * u[t]
    found = poles([ResidualSignals(np.zeros((2000, 1)), u, x, np.zeros((2000, 0)), 0.01)])
    expected = next(q for q in np.linalg.eigvals(A) if q.imag > 0)
    assert len(found) == 1
    assert found[0] == pytest.approx(expected, abs=1e-6)


def test_a_simulation_without_states_has_no_poles():
    assert poles([ResidualSignals(np.zeros((20, 1)), np.zeros((20, 1)), np.zeros((20, 0)), np.zeros((20, 0)), 0.01)]) == []
