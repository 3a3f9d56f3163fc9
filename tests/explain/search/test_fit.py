"""Fits: the optimum is reached along narrow curved valleys, whatever the start."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lsim

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import CONVERGED, Coordinates, Followed, fit, jacobian, rms, weighted
from afdsvc.explain.search.machine import machine
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.actuator_lag import ActuatorLag
from tests.explain import motor

DT, SAMPLES, TAU = 0.01, 400, 3.0


@pytest.fixture(scope="module")
def arm():
    """An arm with damping 2.4 where 1.2 is stated, a load, and a lag of 0.3 s: problem, refit without effects, hypothesis of the lag."""
    rng, t = np.random.default_rng(4), DT * np.arange(SAMPLES)
    u = np.repeat(rng.choice([-6.0, 0.0, 6.0], SAMPLES // 20), 20)
    A, B = np.array([[0, 1, 0], [0, -2.4, 2.2], [0, 0, -1 / 0.3]]), np.array([[0, 0], [0, 1], [1 / 0.3, 0]])
    y = lsim((A, B, np.array([[1.0, 0, 0]]), np.zeros((1, 2))), np.column_stack([u, np.full(SAMPLES, -9.0)]), t)[1]
    recording = Trace("arm", DT, (Channel("u_force"), Channel("y_angle")), np.column_stack([u, y + 0.01 * rng.standard_normal(SAMPLES)]))
    plant = StateSpace(np.array([[0, 1.0], [0, -1.2]]), np.array([[0.0], [2.2]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "deg"), Variable("w", "deg/s", rate_of="q"))
    entry_sd = {"A": np.array([[0, 0], [0, 0.18]]), "B": np.array([[0.0], [0.33]]), "C": np.zeros((1, 2)), "D": np.zeros((1, 1))}
    model = Model("arm", (Variable("force", "1"),), (Variable("angle", "deg"),), states, plant, entry_sd=entry_sd)
    problem = build(nominal(model, DT), prepare(model, [recording]), Settings())
    base = fit(problem, problem.start(), 0.0, TAU)
    lag = next(iter(ActuatorLag().hypotheses(machine(problem, base, 0.0, [], [], "model"))))
    return problem, base, lag


def test_every_start_of_a_lag_reaches_the_optimum_of_another_algorithm(arm):
    """SciPy's trust-region method, reweighted by the residual's variance until it stays."""
    problem, base, lag = arm
    costs = [fit(problem, base.point.added(PlacedEffect(lag, np.array(s))), 0.0, TAU, enough=CONVERGED).cost for s in lag.starts]
    point = base.point.added(PlacedEffect(lag, np.array([0.3])))
    c = Coordinates(problem, point)
    q = c.pack(point)
    for _ in range(10):
        scale = 1 / (rms(weighted(problem, c.unpack(q), 0.0)) * np.sqrt(TAU))

        def residual(x, scale=scale):
            e = np.vstack(weighted(problem, c.unpack(x), 0.0)) * scale
            return np.concatenate([e.ravel(), c.prior_weight * (x - c.prior_mean)])

        q = least_squares(residual, q, x_scale="jac").x
    best = SAMPLES / TAU * float(np.log(rms(weighted(problem, c.unpack(q), 0.0))).sum()) + c.penalty(q)
    assert np.max(costs) == pytest.approx(best, abs=0.5)


def test_a_jacobian_that_follows_steps_is_that_of_broydens_rule():
    """Written out, J + (seen - J s) s^T / s^T s; its products are those of the matrix, output by output."""
    rng = np.random.default_rng(8)
    J, e = rng.standard_normal((60, 4)), rng.standard_normal((30, 2))
    followed, written = Followed(J.copy(), 2), J.copy()
    for _ in range(5):
        step, seen = rng.standard_normal(4), rng.standard_normal((30, 2))
        followed.follow(step, seen)
        written += np.outer(seen.ravel() - written @ step, step) / (step @ step)
    np.testing.assert_allclose(followed.array(), written, rtol=1e-10, atol=1e-10)
    for j in range(2):
        np.testing.assert_allclose(followed.gram[j], written[j::2].T @ written[j::2], rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(followed.along(e)[j], written[j::2].T @ e[:, j], rtol=1e-10, atol=1e-9)
    np.testing.assert_array_equal(followed.J, J)


def test_the_jacobian_is_that_of_central_differences():
    traces = [motor.recording(60.0, s, name=f"r{s}") for s in (1, 2)]
    p = build(nominal(motor.model(), motor.DT), prepare(motor.model(), traces), Settings())
    c = Coordinates(p, p.start())
    q = c.pack(p.start())
    J = jacobian(p, c, q, 0.0, weighted(p, p.start(), 0.0))
    for k in range(c.size):
        step = 1e-3 * np.eye(c.size)[k]
        ends = [np.vstack(weighted(p, c.unpack(q + s * step), 0.0)).ravel() for s in (1, -1)]
        expected = (ends[0] - ends[1]) / 2e-3
        assert J[:, k] == pytest.approx(expected, abs=1e-3 * max(np.abs(expected).max(), 1e-9))
