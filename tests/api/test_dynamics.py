"""User code of a simulator: its numbers as arrays, and one sentence where it fails."""

from __future__ import annotations

import math

import numpy as np
import pytest

from afdsvc.api.dynamics import Values, array_function
from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.errors import BadInput


def function(f):
    class Code:
        def f(self, t, x, u, p):
            return f(x, u, p)

    words = (Variable("u"),), (Variable("y"),), (Variable("x"),)
    model = Model("tank", *words, None, Code(), 0.0, {"area": Quantity(4.0), "flow": Quantity(3.0)})
    return array_function(model, "f", 1)


def called(f):
    return function(f)(0.0, np.array([2.0]), np.array([1.0]), np.array([4.0, 3.0]))


@pytest.mark.parametrize("f", [lambda x, u, p: [p["flow"] * x[0]], lambda x, u, p: p.flow * x[0], lambda x, u, p: np.array([[p.area + x[0]]])])
def test_parameters_have_names(f):
    assert called(f).tolist() == [6.0]


@pytest.mark.parametrize("f", [lambda x, u, p: [1 / 0], lambda x, u, p: [math.sqrt(-x[0])], lambda x, u, p: [np.float64(0.0) / 0.0], lambda x, u, p: [math.exp(1e4)]])
def test_what_has_no_value_is_nan(f):
    assert np.isnan(called(f)).all()


@pytest.mark.parametrize(("f", "said"), [
    (lambda x, u, p: [p["aera"] * x[0]], r"model 'tank': f\(t, x, u, p\) fails with KeyError: 'aera'"), (lambda x, u, p: [x[3]], "fails with IndexError"),
    (lambda x, u, p: [p.aera], "fails with AttributeError: aera"), (lambda x, u, p: ["a"], "fails with ValueError"), (lambda x, u, p: None, "returned 0 values; expected 1"),
    (lambda x, u, p: [1.0, 2.0], "returned 2 values; expected 1"),
])  # fmt: skip
def test_code_that_fails_is_refused_in_one_sentence(f, said):
    with pytest.raises(BadInput, match=said):
        called(f)


def test_code_cannot_change_what_it_is_given():
    def greedy(x, u, p):
        x[0] = u[0] = p["area"] = 9.0
        return [1.0]

    x, u, values = np.array([2.0]), np.array([1.0]), np.array([4.0, 3.0])
    assert function(greedy)(0.0, x, u, values).tolist() == [1.0]
    assert [x.tolist(), u.tolist(), values.tolist()] == [[2.0], [1.0], [4.0, 3.0]]
    assert (Values(a=1.0) | {"a": 5.0}).a == 5.0
