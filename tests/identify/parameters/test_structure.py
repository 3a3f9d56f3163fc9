"""Parameters from physical plants, from uncertain entries, and from Python simulators."""

import numpy as np
import pytest

from afdsvc.api.model import Model, Quantity, Variable
from afdsvc.errors import BadInput
from afdsvc.identify.parameters.structure import model_structure, physical_structure
from afdsvc.identify.preparation import nominal_plant
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.gas_bearing import gas_bearing

IO = ((Variable("force", "N"),), (Variable("position", "m"),), (Variable("q", "m"), Variable("v", "m/s", "q")))
PLANT = StateSpace.of([[0, 1], [0, -2.5]], [[0], [0.0105]], [[1, 0]], [[0]])


class Axis:
    """m dv/dt = u - c v - k q (1 + q^2): linear at rest."""

    @staticmethod
    def f(t, x, u, p):
        return np.array([x[1], (u[0] - p["c"] * x[1] - p["k"] * x[0] * (1 + x[0] ** 2)) / p["m"]])

    @staticmethod
    def h(t, x, u, p):
        return np.array([x[0]])


def test_physical_parameters_come_with_unit_and_range():
    plant = gas_bearing(0)
    structure = physical_structure(plant, ["stiffness_hh", "pole_v"], ["vertical_rate"])
    stiffness, pole = structure.parameters
    assert (stiffness.value, stiffness.unit, stiffness.sd) == (-1.79e6, "1/s^2", pytest.approx(0.05 * 1.79e6))
    assert pole.unit == "rad/s"
    changed = structure.build(np.array([-1e6, 500.0]))
    assert changed.A[2, 0] == -1e6
    assert np.array_equal(changed.A, plant.continuous(stiffness_hh=-1e6, pole_v=500.0).A)
    assert structure.process_inputs[:, 0].tolist() == [0, 0, 0, 1, 0, 0]


def test_entries_move_inside_the_owners_deviations_and_zero_ones_stay():
    model = Model("axis", *IO, PLANT, entry_sd={"A": np.array([[0, 0], [0, 0.1]]), "B": np.array([[0], [0.002]])})
    structure = model_structure(model)
    assert [p.name for p in structure.parameters] == ["A[2,2]", "B[2,1]"]
    assert structure.scales.tolist() == [0.1, 0.002]
    changed = structure.build(np.array([-3.0, 0.02]))
    assert changed.A.tolist() == [[0, 1], [0, -3.0]]
    assert changed.B.tolist() == [[0], [0.02]]
    assert model.plant.A[1, 1] == -2.5  # the model itself is left alone


def test_a_simulator_is_linearised_around_rest():
    parameters = {"m": Quantity(2.0, "kg", 0.1), "c": Quantity(3.0, "N s/m"), "k": Quantity(50.0, "N/m")}
    structure = model_structure(Model("axis", *IO, None, Axis(), parameters=parameters), ["v"])
    assert [(p.name, p.unit, p.sd) for p in structure.parameters] == [
        ("m", "kg", 0.2),
        ("c", "N s/m", pytest.approx(0.15)),
        ("k", "N/m", pytest.approx(2.5)),
    ]
    system = structure.build(np.array([4.0, 3.0, 50.0]))
    assert np.allclose(system.A, [[0, 1], [-12.5, -0.75]], atol=1e-8)
    assert np.allclose(system.B, [[0], [0.25]], atol=1e-8)
    assert np.allclose(system.C, [[1, 0]], atol=1e-8)


class Spool:
    """A temperature that divides by the speed."""

    def f(self, t, x, u, p):
        return [u[0] - p["c"] * x[0], p["heat"] * u[0] / x[0] - x[1]]

    def h(self, t, x, u, p):
        return [x[1]]


def test_a_simulator_without_a_slope_at_rest_is_refused():
    with pytest.raises(BadInput, match=r"model 'spool': f\(t, x, u, p\) has no finite slope where states and inputs are zero"):
        model_structure(Model("spool", *IO, None, Spool(), parameters={"c": Quantity(3.0), "heat": Quantity(2.0)}))


def test_what_cannot_move_is_named():
    with pytest.raises(BadInput, match="model 'axis' leaves no entry uncertain"):
        model_structure(Model("axis", *IO, PLANT))
    with pytest.raises(BadInput, match=r"names no \[parameters\]"):
        model_structure(Model("axis", *IO, None, Axis()))
    with pytest.raises(BadInput, match="process noise on state 'w': the plant has q, v"):
        model_structure(Model("axis", *IO, PLANT, entry_sd={"A": np.full((2, 2), 0.1)}), ["w"])
    with pytest.raises(BadInput, match="has no parameter 'stifness_hh'"):
        physical_structure(gas_bearing(0), ["stifness_hh"])


def test_a_plant_that_samples_cannot_follow_is_refused():
    with pytest.raises(BadInput, match="model 'axis' grows beyond all numbers within a sample of 1 s"):
        nominal_plant(Model("axis", *IO, StateSpace.of([[0, 1], [1e8, 0]], [[0], [1]], [[1, 0]])), 1.0)
