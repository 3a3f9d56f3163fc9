"""The gain of the predictor against an iterated Kalman filter, and on plants without a steady one."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.predictor import SENSOR_NOISE, correction_gain
from afdsvc.lti.statespace import StateSpace

AXIS = StateSpace.of([[0, 1], [-30, -0.8]], [[0], [20]], [[1, 0]])
SCALES = np.array([1.0, 40.0]), np.array([0.5])


def gain(made, scales=SCALES, rho=0.01):
    found = nominal(made, 0.01)
    return found, correction_gain(found, np.zeros(len(found.entries)), scales, rho)


def test_steady_gain(model):
    found, K = gain(model(AXIS))
    s = found.steps(np.zeros(len(found.entries)))
    Q = s.gx @ np.diag([0.0, 0.4**2]) @ s.gx.T
    R = np.array([[(SENSOR_NOISE * 0.5) ** 2]])
    P = np.eye(2)
    for _ in range(5000):
        L = s.phi @ P @ AXIS.C.T @ np.linalg.inv(AXIS.C @ P @ AXIS.C.T + R)
        P = s.phi @ P @ s.phi.T + Q - L @ AXIS.C @ P @ s.phi.T
    assert np.allclose(K, L, rtol=1e-6)


def test_no_unknown_force_is_a_simulation(model):
    assert not gain(model(AXIS), rho=0.0)[1].any()


def test_gain_grows_with_the_unknown_force(model):
    sizes = [np.abs(gain(model(AXIS), rho=rho)[1]).max() for rho in (1e-3, 1e-2, 1e-1)]
    assert sizes == sorted(sizes)


@pytest.mark.parametrize(
    "plant",
    [
        StateSpace.of([[0, 1], [0, 0]], [[0], [1]], [[1, 0]]),
        StateSpace.of([[0, 1], [30, -0.8]], [[0], [20]], [[1, 0]]),
        StateSpace.of([[0, 1], [0, -2]], [[0], [20]], [[0, 1]]),  # a position that no output sees
        StateSpace.of([[0, 0], [0, -2]], [[0], [20]], [[1, 1]]),  # an offset that nothing drives
        StateSpace.of([[3, 0], [0, -2]], [[0], [20]], [[0, 1]]),  # unstable and unseen
        StateSpace.of([[0, 1], [-1e6, 0]], [[0], [1e4]], [[1e-6, 0]]),
    ],
)
def test_difficult_plants_never_raise(model, plant):
    found, K = gain(model(plant), (np.array([1.0, 5.0]), np.array([0.5])))
    assert np.isfinite(K).all()
    s = found.steps(np.zeros(len(found.entries)))
    seen = np.linalg.matrix_rank(np.vstack([plant.C, plant.C @ plant.A])) == 2
    if seen:
        assert K.any()
        assert np.abs(np.linalg.eigvals(s.phi - K @ plant.C)).max() < 1 + 1e-9


@pytest.mark.parametrize("scales", [(np.zeros(2), np.array([0.5])), (np.array([1.0, 40.0]), np.zeros(1))])
def test_signals_of_no_size(model, scales):
    assert np.isfinite(gain(model(AXIS), scales)[1]).all()


def test_sizes_of_units_do_not_matter(model):
    K = gain(model(AXIS))[1]
    small = StateSpace.of(AXIS.A, AXIS.B / 1e6, AXIS.C * 1e3)
    scaled = gain(model(small), (SCALES[0] / 1e6, SCALES[1] / 1e3))[1]
    assert np.allclose(scaled, K / 1e3, rtol=1e-4)


def test_velocities_alone_are_driven(model):
    _, K = gain(model(StateSpace.of([[-2.0]], [[50.0]], [[1.0]])), (np.array([10.0]), np.array([3.0])))
    assert 0 < K[0, 0] < 1


def test_code_uses_its_linearisation(model):
    class Linear:
        @staticmethod
        def f(t, x, u, p):
            return [x[1], -30 * x[0] - 0.8 * x[1] + 20 * u[0]]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    assert np.allclose(gain(model(code=Linear))[1], gain(model(AXIS))[1], rtol=1e-5)
