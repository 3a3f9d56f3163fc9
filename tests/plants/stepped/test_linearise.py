"""The linear part of simulators that only step, against linear plants whose matrices are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.stepped.function_plant import FunctionPlant
from afdsvc.plants.stepped.linearise import linear_part

DT = 1e-2


def plant(seed: int, n: int, m: int, p: int, radius: float = 0.95) -> StateSpace:
    """Return a random sampled plant with its largest pole at ``radius``, D = 0."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace.of(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)), DT)


def stepping(G: StateSpace, looked: bool, bend: float = 0.0, rest: float = 0.0) -> FunctionPlant:
    """Return a function that steps as a plant does; ``bend`` makes its outputs quadratic, ``rest`` shifts them."""

    def step(x, u, dt):
        if x is None:
            x = np.zeros(G.order)
        else:
            x = G.A @ (x if looked else x[0]) + G.B @ u if looked else G.A @ x[0] + G.B @ u
        y = G.C @ x
        return (x if looked else (x,)), y + bend * y * np.abs(y) + rest

    return FunctionPlant(step, "mine", G.inputs, G.outputs)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 2), st.integers(1, 2), st.booleans())
def test_a_linear_plant_is_found_whole(seed, n, m, p, looked):
    G = plant(seed, n, m, p)
    found = linear_part(stepping(G, looked), np.full(m, 0.1), DT, 200, np.random.default_rng(1))
    omega = np.linspace(1, np.pi / DT, 40)
    truth, ours = frequency_response(G, omega), frequency_response(found.plant, omega)
    assert np.abs(ours - truth).max() < 1e-4 * np.abs(truth).max()
    assert found.missed < 1e-4
    assert found.drift == 0.0
    if looked:
        np.testing.assert_allclose(found.plant.A, G.A, atol=1e-5)


def test_an_unstable_plant_is_found_too():
    G = plant(3, 3, 1, 1, 1.02)
    for looked in (True, False):
        found = linear_part(stepping(G, looked), np.ones(1), DT, 200, np.random.default_rng(1))
        assert np.abs(found.plant.poles()).max() == pytest.approx(1.02, rel=1e-5)


def test_where_it_rests_is_reported_and_taken_off():
    found = linear_part(stepping(plant(1, 2, 1, 1), True, rest=7.0), np.ones(1), DT, 200, np.random.default_rng(1))
    assert found.rest == pytest.approx([7.0])
    assert found.missed < 1e-4


def test_a_bent_one_is_said_to_be_bent_by_as_much():
    G = plant(1, 2, 1, 1)
    small, large = (linear_part(stepping(G, True, bend=0.05), np.array([a]), DT, 200, np.random.default_rng(1)) for a in (0.01, 0.3))
    assert large.bent == pytest.approx(30 * small.bent, rel=0.05)  # what is bent grows with the square
    assert small.bent > 0


def test_one_that_is_nothing_but_bent_has_no_linear_part():
    def square(x, u, dt):
        return u * u, np.zeros(1) if x is None else u * u

    with pytest.raises(BadInput, match=r"simulator mine: a linear part of order . misses .* % of its answer to a random push"):
        linear_part(FunctionPlant(square, "mine", 1, 1), np.ones(1), DT, 200, np.random.default_rng(1), name="mine")


def test_one_that_answers_nothing_is_refused():
    silent = FunctionPlant(lambda x, u, dt: (np.zeros(1), np.zeros(1)), "mine", 1, 1)
    with pytest.raises(BadInput, match=r"simulator mine answers to no input pushed by \[2\.0\]"):
        linear_part(silent, np.array([2.0]), DT, 200, np.random.default_rng(1), name="mine")


def test_one_that_moves_by_itself_is_said_to():
    def drifting(x, u, dt):
        x = np.ones(1) if x is None else 0.99 * x + 0.1 * u
        return x, x

    assert linear_part(FunctionPlant(drifting, "mine", 1, 1), np.ones(1), DT, 200, np.random.default_rng(1)).drift > 1
