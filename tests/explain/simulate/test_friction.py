"""Friction: sticking, sliding and reversing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.statespace import StateSpace

MOTOR = StateSpace.of([[-2.0]], [[50.0]], [[1.0]])
AXIS = StateSpace.of([[0, 1], [0, -0.5]], [[0], [10]], [[1, 0]])
FREE_MOTOR = StateSpace.of([[0.0]], [[50.0]], [[1.0]])


def coulomb(p, z, m, dt, out):
    out[0] -= p[0] * math.tanh(z[0] / (p[1] + p[0] * dt))


def quadratic(p, z, m, dt, out):
    out[0] -= p[0] * z[0] * abs(z[0])


def between(p, z, m, dt, out):
    force = p[0] * math.tanh((z[0] - z[1]) / (p[1] + p[0] * dt))
    out[0] -= force
    out[1] += 5 * force


def stribeck(p, z, m, dt, out):
    out[0] -= (p[0] + p[2] * math.exp(-((z[0] / p[3]) ** 2))) * math.tanh(z[0] / (p[1] + p[0] * dt))


class Motor:
    @staticmethod
    def f(t, x, u, p):
        return [-2.0 * x[0] + 50.0 * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def speeds(made, run, effects, x0):
    found = nominal(made, run.dt)
    return Simulator(found, np.zeros((len(x0), found.plant.outputs))).run(run, np.zeros(len(found.entries)), np.array(x0), effects).x


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("python", [False, True])
def test_motor_below_break_away_stays_at_rest(model, recording, effect, share, python):
    made = model(code=Motor, sizes=(1, 1, 1)) if python else model(MOTOR)
    friction = effect(coulomb, "force", [("x", 0)], [("x", 0)], [100.0, 1e-4], "friction")
    U = np.full((300, 1), share * 2.0)
    v = speeds(made, recording(U), [friction], [0.0])[:, 0]
    scale = 100.0 / 2.0  # the friction force over the damping
    assert np.abs(v).max() < 1e-3 * scale


def test_motor_comes_to_rest_and_does_not_chatter(model, recording, effect):
    friction = effect(coulomb, "force", [("x", 0)], [("x", 0)], [100.0, 1e-4], "friction")
    U = np.concatenate([np.full((100, 1), 4.0), np.full((200, 1), 1.0)])
    v = speeds(model(MOTOR), recording(U), [friction], [0.0])[:, 0]
    assert v[99] > 20
    assert np.abs(v[200:]).max() < 0.05
    assert np.abs(np.diff(v[200:])).max() < 1e-6


def test_sliding_follows_the_exact_solution(model, recording, effect):
    friction = effect(coulomb, "force", [("x", 0)], [("x", 0)], [100.0, 1e-4], "friction")
    t = 0.01 * np.arange(400)
    U = (6 * np.sin(4 * t))[:, None]
    v = speeds(model(MOTOR), recording(U), [friction], [0.0])[:, 0]
    exact = held(lambda x, u: -2 * x + 50 * u - 100 * np.tanh(x / 1e-2), U)
    assert np.sqrt(np.mean((v - exact) ** 2)) < 5e-3 * exact.std()


@pytest.mark.parametrize(("law", "numbers"), [(coulomb, [100.0, 1e-4]), (coulomb, [100.0, 5.0]), (stribeck, [60.0, 0.5, 60.0, 10.0])], ids=["sharp", "rounded", "falling"])
@pytest.mark.parametrize("level", [6.0, 2.1])
def test_the_implicit_force_is_that_of_a_root_search_between_the_ends(model, recording, effect, law, numbers, level):
    """By Brent's method in every step, from scratch; a force that would grow beyond the one without it is that of one evaluation."""
    U = np.repeat(np.random.default_rng(5).uniform(-level, level, 40), 25)[:, None]
    v = speeds(model(MOTOR), recording(U), [effect(law, "force", [("x", 0)], [("x", 0)], numbers, "friction")], [0.0])[:, 0]
    phi, x, expected = math.exp(-2.0 * 0.01), 0.0, []

    def force(speed):
        out = np.zeros(1)
        law(numbers, [speed], None, 1e-3 * 0.01, out)
        return out[0]

    for u in U[:, 0]:
        expected.append(x)
        free = phi * x + 25.0 * (1 - phi) * u
        first, gain = force(x + 0.75 * (free - x)), (1 - phi) / 2

        def excess(r, x=x, free=free, first=first, gain=gain):
            return force(x + 0.75 * (free + r * first * gain - x)) / first - r

        r = 0.0 if first == 0 else min(1 + excess(1.0), 1.5) if excess(1.0) > -1e-6 else brentq(excess, 0.0, 1.0, xtol=1e-15, rtol=1e-14)
        x = free + r * first * gain
    assert np.abs(v - expected).max() < 1e-7 * np.abs(expected).max()


def held(rate, U):
    x, found = np.zeros(1), []
    for u in U[:, 0]:
        found.append(x[0])
        x = solve_ivp(lambda t, x, u=u: rate(x, u), (0, 0.01), x, method="LSODA", rtol=1e-9, atol=1e-10).y[:, -1]
    return np.array(found)


def test_axis_sticks_where_it_stopped(model, recording, effect):
    friction = effect(coulomb, "force", [("x", 1)], [("x", 1)], [5.0, 1e-5], "friction")
    U = np.concatenate([np.full((100, 1), 1.0), np.full((900, 1), 0.3)])
    q = speeds(model(AXIS), recording(U), [friction], [0.0, 0.0])[:, 0]
    assert q[-1] > 1
    assert abs(q[-1] - q[600]) < 3e-4 * q[-1]


def test_integrating_motor_and_two_frictions(model, recording, effect):
    frictions = [effect(coulomb, "force", [("x", 0)], [("x", 0)], [60.0, 1e-4], "friction")] * 2
    v = speeds(model(FREE_MOTOR), recording(np.full((200, 1), 2.0)), frictions, [30.0])[:, 0]
    assert np.all(np.diff(v[:100]) < 0)
    assert np.abs(v[-20:]).max() < 0.05


def test_smooth_friction_is_accurate(model, recording, effect, excitation):
    drag = effect(quadratic, "force", [("x", 0)], [("x", 0)], [0.05], "friction")
    v = speeds(model(MOTOR), recording(excitation), [drag], [0.0])[:, 0]
    exact = held(lambda x, u: -2 * x + 50 * u - 0.05 * x * np.abs(x), excitation)
    assert np.sqrt(np.mean((v - exact) ** 2)) < 2e-3 * exact.std()


def test_friction_between_two_masses_locks_them(model, recording, effect, excitation):
    plant = StateSpace.of([[-0.5, 0], [0, -0.1]], [[10], [0]], [[1, 0]])
    friction = effect(between, "force", [("x", 0), ("x", 1)], [("x", 0), ("x", 1)], [50.0, 1e-4], "friction")
    x = speeds(model(plant), recording(excitation), [friction], [0.0, 0.0])
    assert np.abs(x[50:, 0] - x[50:, 1]).max() < 5e-3 * x.std()
