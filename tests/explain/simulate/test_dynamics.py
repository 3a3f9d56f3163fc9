"""Python code made callable from the kernel: what is compiled, and what runs in the interpreter instead."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pytest

from afdsvc.api.dynamics import Values
from afdsvc.errors import BadInput
from afdsvc.explain.simulate.dynamics import program
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.explain.simulate.simulator import Simulator

GRAVITY = 9.81
LEVERS = [0.5, 2.0]


def torque(q, p):
    return p["mass"] * GRAVITY * math.sin(q) * gear(1.0)


def gear(ratio):
    return ratio * LEVERS[1] / 2.0


class Instance:
    """Constants of an instance, its methods, a table, a clipped and an integer value."""

    table: ClassVar = {"soft": 0.5}

    def __init__(self):
        self.inertia = 2.0
        self.offsets = [0.0, 0.1]

    def spring(self, q):
        return self.table["soft"] * q

    def f(self, t, state, force, parameters):
        (q, v) = state
        (u,) = force
        drive = min(max(u, -1), 1)
        if v > 0:
            drag = parameters.drag * v
        else:
            drag = parameters["drag"] * 2 * v
        rate = np.zeros(2)
        rate[0] = v
        rate[1] = (drive - drag - torque(q, parameters) - self.spring(q) + self.offsets[1] * math.sin(t)) / self.inertia
        return rate

    def h(self, t, state, force, parameters):
        return state[0] + 0.1 * force[0]


class Interpreted:
    """Code that numba does not take."""

    @staticmethod
    def f(t, x, u, p):
        total = sum(p[name] * value for name, value in zip(("a", "b"), x, strict=True))
        return [x[1], -total + u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


class Compiled:
    @staticmethod
    def f(t, x, u, p):
        return [x[1], -(p["a"] * x[0] + p["b"] * x[1]) + u[0]]

    @staticmethod
    def h(t, x, u, p):
        return [x[0]]


def outputs(made, run, theta=None):
    found = nominal(made, run.dt)
    simulator = Simulator(found, np.zeros((2, 1)))
    return simulator.run(run, np.zeros(len(found.entries)), np.array([0.2, 0.0])).y, simulator.notes


def test_objects_helpers_and_constants_are_compiled(model, recording, excitation):
    made = model(code=Instance(), parameters={"drag": 0.3, "mass": 1.5})
    run = recording(excitation)
    y, notes = outputs(made, run)
    assert notes == ()
    slow, _ = outputs(model(code=Hidden(Instance()), parameters={"drag": 0.3, "mass": 1.5}), run)
    assert np.abs(y - slow).max() < 1e-9


class Changed:
    """Code that calls other code with parameters of its own; those of the caller stay."""

    def f(self, t, x, u, p):
        p = p | {"a": 2 * p["a"], "b": p["a"] + p["b"]}
        return Compiled.f(t, x, u, p)

    def h(self, t, x, u, p):
        return [x[0] + 0 * len(p | {"a": 0.0})]


def test_code_may_change_a_copy_of_its_parameters(model, recording, excitation):
    run = recording(excitation)
    y, notes = outputs(model(code=Changed(), parameters={"a": 15.0, "b": -14.2}), run)
    same, _ = outputs(model(code=Compiled, parameters={"a": 30.0, "b": 0.8}), run)
    assert notes == ()
    assert y == pytest.approx(same, rel=1e-12, abs=1e-15)
    given = Values(a=1.0, b=2.0)
    assert (given | {"b": 5.0}).b == 5.0
    assert given.b == 2.0


def test_a_parameter_that_the_model_does_not_have_is_not_changed_in_compiled_code(model, recording, excitation):
    class Unknown(Changed):
        def f(self, t, x, u, p):
            p = p | {"c": 1.0}
            return Compiled.f(t, x, u, p)

    _, notes = outputs(model(code=Unknown(), parameters={"a": 30.0, "b": 0.8}), recording(excitation))
    assert "parameter 'c' is not among those of the model" in notes[0]


class Hidden:
    """The same code behind calls that cannot be followed."""

    def __init__(self, inner):
        self.f = lambda *given: inner.f(*given)
        self.h = lambda *given: inner.h(*given)


def test_what_numba_refuses_runs_in_the_interpreter_and_is_noted(model, recording, excitation):
    run = recording(excitation)
    slow, notes = outputs(model(code=Interpreted, parameters={"a": 30.0, "b": 0.8}), run)
    fast, none = outputs(model(code=Compiled, parameters={"a": 30.0, "b": 0.8}), run)
    assert none == ()
    assert len(notes) == 1
    assert notes[0].startswith("f of model 'test' is not compiled")
    assert np.abs(slow - fast).max() < 1e-9


def test_code_without_source_runs_in_the_interpreter(model, recording, excitation):
    scope = {}
    exec("class Made:\n    @staticmethod\n    def f(t, x, u, p):\n        return [x[1], -30 * x[0] + u[0]]\n"
         "    @staticmethod\n    def h(t, x, u, p):\n        return [x[0]]\n", scope)
    y, notes = outputs(model(code=scope["Made"]), recording(excitation))
    assert len(notes) == 2
    assert np.isfinite(y).all()


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (lambda t, x, u, p: [x[0]], r"f\(t, x, u, p\) returned 1 values; expected 2"),
        (lambda t, x, u, p: [x[1], p["missing"]], r"f\(t, x, u, p\) fails with KeyError: 'missing'"),
        (lambda t, x, u, p: [x[1], x[5]], r"f\(t, x, u, p\) fails with IndexError"),
    ],
)
def test_code_that_fails_is_refused_in_one_sentence(model, body, said):
    class Wrong:
        f = staticmethod(body)
        h = staticmethod(lambda t, x, u, p: [x[0]])

    with pytest.raises(BadInput, match=said):
        nominal(model(code=Wrong), 0.01)


def test_division_by_zero_at_rest_is_no_failure(model, recording, excitation):
    class Magnet:
        @staticmethod
        def f(t, x, u, p):
            return [x[1], 10 - p["k"] * (u[0] / x[0]) ** 2 - 5 * x[1]]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    made = model(code=Magnet, parameters={"k": 10.0})
    assert program(made).notes == ()
    assert np.isfinite(nominal(made, 0.01).plant.A).all()
    y, _ = outputs(made, recording(0.2 + 0.0 * excitation))
    assert np.isfinite(y).all()


def test_code_that_turns_nan_ends_the_simulation_quietly(model, recording):
    class Root:
        @staticmethod
        def f(t, x, u, p):
            return [x[1], -math.sqrt(x[0]) - 1.0]

        @staticmethod
        def h(t, x, u, p):
            return [x[0]]

    run = recording(np.zeros((300, 1)))
    fast, _ = outputs(model(code=Root), run)
    slow, _ = outputs(model(code=Hidden(Root)), run)
    assert np.array_equal(np.isnan(fast), np.isnan(slow))
    assert np.isnan(fast[-1, 0])
