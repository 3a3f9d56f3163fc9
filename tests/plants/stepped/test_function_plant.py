"""A Python function as a plant: the state is a value, and what a function does wrong is reported in its name."""

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.stepped.function_plant import FunctionPlant


def lag(x, u, dt, gain=1.0):
    """x' = -5 x + u, exactly."""
    x = np.zeros(1) if x is None else x
    e = np.exp(-5 * dt)
    x = e * x + (1 - e) / 5 * u
    return x, gain * x


def test_it_steps_as_its_formula_and_begins_anew():
    plant = FunctionPlant(lag, "lag", 1, 1, {"gain": 10.0})
    for _ in range(2):
        assert plant.begin() == [0.0]
        y = [plant.advance(np.ones(1), 0.1)[0] for _ in range(20)]
        np.testing.assert_allclose(y, 2 * (1 - np.exp(-0.5 * np.arange(1, 21))), rtol=1e-12)
        np.testing.assert_allclose(plant.states(), np.array(y[-1:]) / 10)
    plant.close()
    assert plant.states().shape == (0,)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda x, u, dt: 1 / 0, "simulator mine fails: ZeroDivisionError"),
        (lambda x, u, dt: 3, "simulator mine fails: TypeError"),
        (lambda x, u, dt: (None, [1.0, 2.0]), r"simulator mine returns outputs of shape \(2,\); expected \(1,\)"),
        (lambda x, u, dt: (None, [float("nan")]), "simulator mine returns nan for output 0; expected finite numbers"),
        (lambda x, u, dt: (None, float("inf")), "returns inf for output 0"),
        (lambda x, u, dt: (None, ["a"]), "simulator mine fails: ValueError"),
    ],
)
def test_what_it_does_wrong_is_reported_in_its_name(function, said):
    with pytest.raises(BadInput, match=said):
        FunctionPlant(function, "mine", 1, 1).begin()


def test_a_state_that_is_no_vector_cannot_be_looked_at():
    plant = FunctionPlant(lambda x, u, dt: ({"q": 1}, [0.0]), "mine", 1, 1)
    plant.begin()
    assert plant.states().shape == (0,)
