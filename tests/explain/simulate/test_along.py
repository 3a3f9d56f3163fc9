"""Forces that act along a signal: on all axes of a mechanism, in the proportions in which the signal does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from afdsvc.api.model import Variable
from afdsvc.api.physics import Signal
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.simulator import Simulator
from afdsvc.lti.sampling import continuous
from afdsvc.lti.statespace import StateSpace

DT = 0.01
CART, POLE, ARM, WEIGHT, RUB, SWING = 0.9, 0.25, 0.3, 9.81, 2.0, 0.006  # kg, kg, m, m/s^2, N s/m, N m s
MASSES = np.array([[CART + POLE, POLE * ARM], [POLE * ARM, POLE * ARM**2]])  # of cart and hanging pole, at rest
INVERSE = np.linalg.inv(MASSES)
A = np.block([[np.zeros((2, 2)), np.eye(2)], [INVERSE @ np.diag([0.0, -POLE * WEIGHT * ARM]), INVERSE @ np.diag([-RUB, -SWING])]])
B = np.vstack([np.zeros((2, 1)), INVERSE[:, :1]])
LINEAR = StateSpace(A, B, np.eye(2, 4), np.zeros((2, 1)))
STATES = (Variable("cart"), Variable("angle"), Variable("v", rate_of="cart"), Variable("w", rate_of="angle"))


class CartPole:
    """The cart and the pole that hangs from it, at any angle; the motor gives ``gain`` times its input, which is limited."""

    @staticmethod
    def f(t, x, u, p):
        s, c = math.sin(x[1]), math.cos(x[1])
        push = min(max(u[0], -p["limit"]), p["limit"]) - 2.0 * x[2] + 0.075 * x[3] * x[3] * s
        turn = -0.006 * x[3] - 0.73575 * s
        a, b, d = 1.15, 0.075 * c, 0.0225
        det = a * d - b * b
        return [x[2], x[3], (d * push - b * turn) / det, (a * turn - b * push) / det]

    @staticmethod
    def h(t, x, u, p):
        return [x[0], x[1]]


def constant(p, z, m, dt, out):
    out[0] += p[0]


def cube(p, z, m, dt, out):
    out[0] -= p[0] * z[0] ** 3


def dry(p, z, m, dt, out):
    out[0] -= p[0] * math.tanh(z[0] / (p[1] + p[0] * dt))


@pytest.fixture
def placed(effect):
    def make(law, reads, row, along, values, family=""):
        made = effect(law, "force", reads, [("x", row)], values, family)
        return replace(made, hypothesis=replace(made.hypothesis, along=along))

    return make


def play(model, run, effects, substeps=1):
    found = nominal(model, run.dt)
    return found, Simulator(found, np.zeros((4, 2)), substeps=substeps).run(run, np.zeros(len(found.entries)), np.array([0.0, 0.1, 0.0, 0.0]), effects)


def true(U, push, turn):
    """Return the motion by the masses alone, ``M(angle) q'' = forces``; ``push(x)`` acts on the cart and ``turn(x)`` on the pole, besides input, weight and damping."""

    def rates(_, x, u):
        s, c = np.sin(x[1]), np.cos(x[1])
        M = np.array([[CART + POLE, POLE * ARM * c], [POLE * ARM * c, POLE * ARM**2]])
        forces = [u - RUB * x[2] + POLE * ARM * x[3] ** 2 * s + push(x), -SWING * x[3] - POLE * WEIGHT * ARM * s + turn(x)]
        return np.concatenate([x[2:], np.linalg.solve(M, forces)])

    states = [np.array([0.0, 0.1, 0.0, 0.0])]
    for u in U[:-1, 0]:
        states.append(solve_ivp(rates, (0, DT), states[-1], args=(u,), rtol=1e-9, atol=1e-11).y[:, -1])
    return np.array(states)


@pytest.mark.parametrize("sampled", [False, True])
def test_a_force_along_an_input_acts_as_a_change_of_that_input(model, recording, placed, excitation, sampled):
    plant = replace(LINEAR, A=A - np.diag([0.1, 0, 0, 0]))  # without a pole at zero, so that the sampled one has a continuous twin
    size = 0.7 * B[2, 0]
    if sampled:
        sampled_A, sampled_B, *_ = cont2discrete((plant.A, plant.B, plant.C, plant.D), DT)
        plant = StateSpace(sampled_A, sampled_B, plant.C, plant.D, DT)
        assert continuous(plant) is not None
    machine = replace(model(plant, sample_time=DT if sampled else 0.0), states=STATES)
    _, forced = play(machine, recording(excitation, 2), [placed(constant, [("x", 2)], 2, Signal("u", 0), [size])])
    _, moved = play(machine, recording(excitation + 0.7, 2), [])
    _, plain = play(machine, recording(excitation, 2), [])
    assert np.abs(forced.y - moved.y).max() < 1e-6 * np.abs(moved.y - plain.y).max()


@pytest.mark.parametrize(("read", "size"), [(1, 300.0), (3, 3.0)])
def test_a_force_along_a_state_acts_as_a_force_on_that_coordinate_does(model, recording, placed, excitation, read, size):
    """A cubic spring and a cubic damper of the pole: the masses alone say what they do to the cart."""
    machine = replace(model(LINEAR), states=STATES)
    _, made = play(machine, recording(excitation, 2), [placed(cube, [("x", read)], 3, Signal("x", read), [size])], 8)
    states = [np.array([0.0, 0.1, 0.0, 0.0])]
    for u in excitation[:-1, 0]:
        def rates(_, x, u=u):
            return A @ x + B[:, 0] * u + np.concatenate([[0, 0], INVERSE[:, 1] * -size / INVERSE[1, 1] * x[read] ** 3])

        states.append(solve_ivp(rates, (0, DT), states[-1], rtol=1e-9, atol=1e-11).y[:, -1])
    assert np.abs(made.x - np.array(states)).max(0) == pytest.approx(0, abs=3e-3 * np.abs(states).max())
    _, alone = play(machine, recording(excitation, 2), [placed(cube, [("x", read)], 3, None, [size])], 8)
    assert np.abs(alone.x - np.array(states)).max() > 0.01 * np.abs(states).max()


@pytest.mark.parametrize(("force", "tolerance"), [(0.8, 0.01), (2.5, 0.02)])
def test_friction_of_the_cart_moves_the_pole_at_any_angle(model, recording, placed, excitation, force, tolerance):
    machine = replace(model(code=CartPole, sizes=(4, 1, 2), parameters={"limit": 100.0}), states=STATES)
    drive = 5 * excitation
    found, made = play(machine, recording(drive, 2), [placed(dry, [("x", 2)], 2, Signal("u", 0), [force * B[2, 0], 0.01], "friction")], 4)
    whole = true(drive, lambda x: -force * np.tanh(x[2] / 0.01), lambda x: 0.0)
    assert found.plant.B[2, 0] == pytest.approx(B[2, 0], rel=1e-3)
    assert np.abs(whole[:, 1]).max() > 1  # far from the angle at which the model is linearised
    assert (np.linalg.norm(made.x - whole, axis=0) < tolerance * np.linalg.norm(whole - whole.mean(0), axis=0)).all()
    _, alone = play(machine, recording(drive, 2), [placed(dry, [("x", 2)], 2, None, [force * B[2, 0], 0.01], "friction")], 4)
    assert np.linalg.norm(alone.x - whole) > 10 * np.linalg.norm(made.x - whole)


def test_a_force_acts_where_code_limits_the_input_too(model, recording, placed, excitation):
    """There the rates do not follow the input; the force goes on as it last did."""
    machine = replace(model(code=CartPole, sizes=(4, 1, 2), parameters={"limit": 1.0}), states=STATES)
    drive = np.where(np.arange(len(excitation)) < 5, 0.0, 3.0)[:, None] * np.ones((1, 1))
    _, made = play(machine, recording(drive[:60], 2), [placed(constant, [("x", 2)], 2, Signal("u", 0), [-0.5 * B[2, 0]])], 4)
    whole = true(np.minimum(drive[:60], 1.0), lambda x: -0.5, lambda x: 0.0)
    assert np.abs(made.x - whole).max() < 0.02 * np.abs(whole).max()
