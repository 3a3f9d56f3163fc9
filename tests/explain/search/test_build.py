"""How a plant that falls over by itself is simulated: in its loop where that can be closed, else corrected by the recordings."""

import importlib.util
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.api.physics import Signal
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import _force, build, growth
from afdsvc.explain.search.problem import LOST, _residual
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.verdict.holdout import on
from afdsvc.lti.statespace import StateSpace

_spec = importlib.util.spec_from_file_location("odd_machines", Path(__file__).parents[1] / "test_odd_machines.py")
odd = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(odd)


@pytest.mark.parametrize(("known", "open_heldout", "closed"), [(True, False, True), (True, True, False), (False, False, False)])
def test_the_loop_is_closed_where_all_recordings_allow_it(known, open_heldout, closed):
    model = odd.falling(known)
    fitted, held = prepare(model, [odd.balanced(0, 0.3), odd.balanced(1, 0.2)])
    problem = build(nominal(model, odd.DT), [fitted], Settings(), [replace(held, W=None) if open_heldout else held])
    assert problem.closed == closed
    assert problem.settings.horizons == ((0.0,) if closed else Settings().horizons)


def test_the_size_of_a_parameter_is_its_stated_value():
    class Code:
        f = staticmethod(lambda t, x, u, p: [u[0] - p["loss"] * x[0]])
        h = staticmethod(lambda t, x, u, p: [x[0]])

    words = (Variable("u"),), (Variable("y"),), (Variable("x"),)
    model = Model("store", *words, None, Code, 0.0, {"none": Quantity(0.0), "loss": Quantity(-3.0)})
    data = np.random.default_rng(1).standard_normal((200, 2))
    runs = prepare(model, [Trace("r", 0.1, (Channel("u_u", ""), Channel("y_y", "")), data)])
    problem = build(nominal(model, 0.1), runs, Settings(), runs)
    assert [problem.size(Signal("p", k)) for k in (0, 1)] == [1.0, 3.0]


def test_a_plant_that_leaves_all_numbers_within_a_sample_grows_without_limit():
    words = (Variable("u"),), (Variable("y"),), (Variable("x"),)
    assert growth(nominal(Model("burst", *words, StateSpace.of([[1e4]], [[1.0]], [[1.0]])), 1.0)) == np.inf
    assert growth(nominal(Model("store", *words, StateSpace.of([[-2.0]], [[1.0]], [[1.0]])), 1.0)) == pytest.approx(np.exp(-2))


def test_missing_readings_count_for_nothing_and_a_simulation_that_left_for_as_much_as_is_lost():
    Y, y, e = np.array([[1.0, np.nan], [3.0, 4.0], [5.0, 6.0]]), np.array([[0.0, 1.0], [np.nan, 1e9], [-np.inf, 5.0]]), np.empty((3, 2))
    _residual(Y, y, np.array([0.5, 0.0]), np.array([2.0, 1.0]), e)
    assert e.tolist() == [[0.25, 0.0], [LOST, LOST], [LOST, 1.0]]


STEP = 1 / 150


class Pendulum:
    """A pendulum that swings by any angle."""

    def f(self, t, x, u, p):
        return [x[1], -p["stiffness"] * math.sin(x[0])]

    def h(self, t, x, u, p):
        return [x[0]]


def swing(angle: float, rate: float) -> Trace:
    """Return 40 s of a pendulum let go, by another integrator than the product's."""
    found = solve_ivp(lambda t, x: [x[1], -23.0 * np.sin(x[0])], (0, 40), [angle, rate], t_eval=np.arange(6000) * STEP, rtol=1e-9, atol=1e-9)
    return Trace("swing", STEP, (Channel("y_angle", "rad"),), found.y[:1].T)


@pytest.mark.parametrize(("angle", "rate"), [(-2.8, 1.5), (2.5, 2.0), (0.3, -2.0), (3.1, 0.2)])
def test_the_initial_state_is_found_far_from_what_was_fitted(angle, rate):
    states = (Variable("q", "rad"), Variable("w", "rad/s", rate_of="q"))
    model = Model("pendulum", (), (Variable("angle", "rad"),), states, plant=None, dynamics=Pendulum(), parameters={"stiffness": Quantity(23.0, "1/s^2", 0.1)})
    fitted, held = prepare(model, [swing(0.1, 0.0), swing(angle, rate)])
    found = on(build(nominal(model, STEP), [fitted], Settings()), [held]).x0[0]
    assert found == pytest.approx([angle, rate], abs=0.1)


@pytest.mark.parametrize("inputs", [0, 1])
def test_the_scale_of_unknown_forces_on_a_machine_that_nothing_drives_is_that_of_its_free_motion(inputs):
    """Oracle: the rms of velocity and acceleration of a decay from rest, simulated by scipy; an input that is zero drives nothing."""
    A = np.array([[0, 1.0], [-900.0, -0.6]])
    decay = solve_ivp(lambda t, x: A @ x, (0, 20), [3.0, 0.0], t_eval=np.arange(0, 20, 0.005), rtol=1e-9, atol=1e-12).y
    free = nominal(pushed(A, inputs), 0.005)
    (run,) = prepare(free.model, [Trace("decay", 0.005, (*[Channel("u_f", "N")] * inputs, Channel("y_q", "m")), np.column_stack([*[0 * decay[0]] * inputs, decay[0]]))])
    expected = np.sqrt(np.mean((A @ decay) ** 2, axis=1))
    assert _force(free, [run], np.array([decay[0].std()])) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("A", [[[0, 1.0], [9.0, -0.1]], [[0, 1.0], [0, 0]]])
def test_it_is_one_where_free_motion_has_no_size(A):
    fallen = nominal(pushed(np.array(A), 0), 0.005)
    (run,) = prepare(fallen.model, [Trace("r", 0.005, (Channel("y_q", "m"),), np.linspace(0, 1, 200)[:, None])])
    assert _force(fallen, [run], np.ones(1)).tolist() == [1.0, 1.0]


def test_it_is_one_of_a_discrete_plant_and_none_where_there_is_no_state():
    readings = Trace("r", 0.005, (Channel("y_q", "m"),), np.linspace(0, 1, 200)[:, None])
    stepped = StateSpace(np.array([[-0.9]]), np.zeros((1, 0)), np.eye(1), np.zeros((1, 0)), 0.005)
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((1, 0)), np.zeros((1, 0)))
    for plant, expected in ((stepped, [1.0]), (gain, [])):
        q = Variable("q", "m")
        free = nominal(Model("free", (), (q,), (q,) * plant.order, plant), 0.005)
        assert _force(free, prepare(free.model, [readings]), np.ones(1)).tolist() == expected


def pushed(A, inputs: int) -> Model:
    """A mass with as many inputs as asked for, none or one."""
    plant = StateSpace(A, np.array([[0.0], [1.0]])[:, :inputs], np.array([[1.0, 0]]), np.zeros((1, inputs)))
    states = (Variable("q", "m"), Variable("v", "m/s", rate_of="q"))
    return Model("mass", (Variable("f", "N"),)[:inputs], (Variable("q", "m"),), states, plant)
