"""Free numbers of a model, and where Python code is linearised."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.explain.simulate.nominal import entry_name, nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.transfer_function import from_polynomials


class Pendulum:
    @staticmethod
    def f(t, x, u, p):
        return [x[1], -p["k"] * math.sin(x[0]) - p["d"] * x[1] + p["b"] * u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


PARAMETERS = {"k": 30.0, "d": 0.8, "b": 20.0}


def test_entries_of_matrices(model):
    plant = StateSpace.of([[0, 1], [-30, -0.8]], [[0], [20]], [[1, 0]])
    found = nominal(model(plant), 0.01)
    assert [e.name for e in found.entries] == ["A[2,1]", "A[2,2]", "B[2,1]"]
    moved = found.at(np.array([1.0, 0.0, -2.0]))
    assert moved.A[1, 0] == pytest.approx(-30 + 1.5)
    assert moved.B[1, 0] == pytest.approx(20 - 2.0)
    assert found.values(np.array([1.0, 0.0, -2.0])) == pytest.approx({"A[2,1]": -28.5, "A[2,2]": -0.8, "B[2,1]": 18.0})
    assert found.moved(np.array([1.0, 0.0, -2.0])).plant.A[1, 0] == moved.A[1, 0]


def test_numbers_of_a_transfer_function_are_its_coefficients():
    system = from_polynomials([[[2.0, 6], [4.0]], [[3.0], [5.0]]], [[[1, 3, 7.0], [1, 3, 7.0]], [[1, 4.0], [1, 4.0]]])
    stated = Model.from_system(system, {"force": "N", "heat": "W"}, {"place": "m", "warmth": "K"})
    found = nominal(replace(stated, transfer=True), 0.01)
    names = {(e.matrix, e.row, e.column): entry_name(found, e) for e in found.entries}
    assert names == {
        ("A", 0, 0): "den of place, s^1", ("A", 1, 0): "den of place, s^0", ("A", 2, 2): "den of warmth", ("B", 0, 0): "num from force to place, s^1",
        ("B", 1, 0): "num from force to place, s^0", ("B", 1, 1): "num from heat to place, s^0", ("B", 2, 0): "num from force to warmth", ("B", 2, 1): "num from heat to warmth",
    }  # fmt: skip
    assert entry_name(nominal(stated, 0.01), found.entries[0]) == "A[place, place]"


@pytest.mark.parametrize("dt", [0.0, 0.01])
def test_derivatives_of_an_output_have_its_coefficients_too(dt):
    found = nominal(Model.from_system(control.tf([50.0], [1, 3.0, 7.0], dt), "force", "place"), 0.01)
    assert [entry_name(found, e) for e in found.entries] == [f"den of place, {v}" for v in (("s^0", "s^1") if dt == 0 else ("z^1", "z^0"))] + [f"num from force to place, {'z' if dt else 's'}^0"]


def test_a_transfer_function_sampled_anew_has_entries_of_matrices():
    found = nominal(Model.from_system(control.tf([0.5], [1, -0.9], 0.01), "force", "place"), 0.005)
    assert [entry_name(found, e) for e in found.entries] == ["A[place, place]", "B[place, force]"]


def test_stated_deviations_choose_the_entries(model):
    plant = StateSpace.of([[0, 1], [0, 0]], [[0], [20]], [[1, 0]])
    zero = {k: np.zeros(getattr(plant, k).shape) for k in "ABCD"}
    found = nominal(model(plant, entry_sd={**zero, "A": np.array([[0, 0], [0, 0.16]])}), 0.01)
    assert [(e.name, e.sd) for e in found.entries] == [("A[2,2]", 0.16)]


def test_large_black_box_moves_by_its_gains(model):
    rng = np.random.default_rng(3)
    plant = StateSpace.of(0.1 * rng.standard_normal((8, 8)), rng.standard_normal((8, 2)), rng.standard_normal((2, 8)), dt=0.01)
    found = nominal(model(plant, entry_sd={k: 0.2 * np.abs(getattr(plant, k)) for k in "ABCD"}), 0.01)
    assert [(e.name, e.sd) for e in found.entries] == [(n, pytest.approx(0.2)) for n in ("gain of u0", "gain of u1", "gain of y0", "gain of y1")]
    moved = found.at(np.array([1.0, 0.0, 0.0, -1.0]))
    assert np.allclose(moved.B, plant.B * [1.2, 1.0])
    assert np.allclose(moved.C, plant.C * [[1.0], [0.8]])
    assert found.values(np.zeros(4)) == {"gain of u0": 1.0, "gain of u1": 1.0, "gain of y0": 1.0, "gain of y1": 1.0}


def test_parameters_of_code(model):
    made = model(code=Pendulum, parameters=PARAMETERS)
    found = nominal(made, 0.01)
    assert [(e.matrix, e.row, e.name) for e in found.entries] == [("parameter", 0, "k"), ("parameter", 1, "d"), ("parameter", 2, "b")]
    theta = np.array([1.0, 0.0, -1.0])
    assert found.values(theta) == pytest.approx({"k": 33.0, "d": 0.8, "b": 18.0})
    assert np.allclose(found.at(theta).A, [[0, 1], [-33, -0.8]], atol=1e-6)
    assert {n: q.value for n, q in found.moved(theta).parameters.items()} == pytest.approx(found.values(theta))


def test_code_is_linearised_where_the_inputs_balance(model):
    made = model(code=Pendulum, parameters=PARAMETERS)
    found = nominal(made, 0.01, np.array([0.75]))
    assert found.point is not None
    assert found.point[0] == pytest.approx([math.asin(0.5), 0.0], abs=1e-9)
    assert found.plant.A[1, 0] == pytest.approx(-30 * math.cos(math.asin(0.5)), rel=1e-6)
    unbalanced = nominal(made, 0.01, np.array([3.0]))
    assert unbalanced.point is not None
    assert np.array_equal(unbalanced.point[0], [0, 0])


class Tanks:
    """Two upper tanks that empty into two lower ones, pumps that feed one of each; the outflow of an empty tank has no slope."""

    @staticmethod
    def f(t, x, u, p):
        a, b, c, d = (p["a"] * math.sqrt(1962 * max(level, 0.0)) for level in x)
        return [(0.7 * u[0] + c - a) / 28, (0.6 * u[1] + d - b) / 28, (0.4 * u[1] - c) / 28, (0.3 * u[0] - d) / 28]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


class Filling(Tanks):
    """By samples of 2 s."""

    @staticmethod
    def f(t, x, u, p):
        return [x[k] + 2.0 * rate for k, rate in enumerate(Tanks.f(t, x, u, p))]


@pytest.mark.parametrize(("code", "sample_time"), [(Tanks, 0.0), (Filling, 2.0)])
def test_tanks_are_linearised_at_the_level_that_the_inflow_holds(model, code, sample_time):
    """From empty tanks no balance is found, and poles there are as fast as one likes: every sample took a hundred steps."""
    u, a = np.array([9.6, 10.2]), 0.07
    flows = np.array([0.7 * u[0] + 0.4 * u[1], 0.6 * u[1] + 0.3 * u[0], 0.4 * u[1], 0.3 * u[0]])
    levels = (flows / a) ** 2 / 1962
    found = nominal(model(code=code, parameters={"a": a}, sizes=(4, 2, 1), sample_time=sample_time), 2.0, u)
    assert found.point[0] == pytest.approx(levels, rel=1e-6)
    poles = -np.sort(a * np.sqrt(1962 / levels) / 56)
    assert np.sort(found.plant.poles().real)[::-1] == pytest.approx(1 + 2.0 * poles if sample_time else poles, rel=1e-4)
    assert found.steps(np.zeros(1)).nsub == 1


def test_no_input(model):
    plant = StateSpace.of([[0, 1], [-30, -0.8]], np.zeros((2, 0)), [[1, 0]], np.zeros((1, 0)))
    found = nominal(model(plant), 0.01)
    assert found.at(np.zeros(2)).B.shape == (2, 0)
    assert found.steps(np.zeros(2)).gam.shape == (2, 0)


def test_model_without_anything_is_refused(model):
    with pytest.raises(BadInput, match="neither matrices nor a simulator"):
        nominal(model(), 0.01)


class Orifice:
    """A tank that empties through a square root, at rest where the root has no slope; one output has a direct part."""

    @staticmethod
    def f(t, x, u, p):
        return [x[1] + 3.0 * u[0], -2.0 * math.sqrt(x[0]) - p["d"] * x[1] + 4.0 * u[1]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0] + 0.5 * u[1]]


class Followed:
    """The same behind calls that cannot be compiled."""

    f = staticmethod(lambda *given: Orifice.f(*given))
    h = staticmethod(lambda *given: Orifice.h(*given))


@pytest.mark.parametrize("code", [Orifice, Followed])
def test_linearised_code_has_the_slopes_of_states_and_inputs_and_none_where_there_is_none(model, code):
    found = nominal(model(code=code, sizes=(2, 2, 1), parameters={"d": 0.7}), 0.01)
    assert bool(found.program.notes) == (code is Followed)
    for part, expected in (("A", [[0, 1], [0, -0.7]]), ("B", [[3, 0], [0, 4]]), ("C", [[1, 0]]), ("D", [[0, 0.5]])):
        assert getattr(found.plant, part) == pytest.approx(np.array(expected), abs=1e-8)
