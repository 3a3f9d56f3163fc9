"""Laws between the axes of a machine: an input that acts where the model has another one, an inertia that another axis changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from afdsvc.api.physics import Axis, Hypothesis, Machine, Size
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.actuator_crosstalk import ActuatorCrosstalk
from afdsvc.plugins.physics.inertia_follows_position import InertiaFollowsPosition
from afdsvc.plugins.physics.velocity_coupling import VelocityCoupling

A = np.array([[0, 1.0, 0, 0], [-9.0, -0.5, 0, 0], [0, 0, 0, 1.0], [0, 0, -4.0, -0.8]])
B = np.array([[0, 0], [8.0, 0], [0, 0], [0, 3.0]])
PLANT = StateSpace(A, B, np.eye(4)[[0, 2]], np.zeros((2, 2)))


def size(index: int, name: str, unit: str) -> Size:
    return Size(index, name, unit, 0.0, 0.5, 2.0)


def arm(plant: StateSpace = PLANT, lift: str = "rad", turn: str = "rad") -> Machine:
    """A machine of two axes, each with a motor."""
    states = tuple(size(i, n, u) for i, (n, u) in enumerate([("lift", lift), ("lift_rate", f"{lift}/s"), ("turn", turn), ("turn_rate", f"{turn}/s")]))
    axes = tuple(Axis(states[k].name, states[k], states[k + 1], 2.0, i, float(plant.B[k + 1, i]), "V") for i, k in enumerate((0, 2)))
    return Machine(
        tuple(size(i, n, "V") for i, n in enumerate(["main", "tail"])), (states[0], states[2]), states, axes, {}, 0.01, 20.0, 10.0, plant, np.ones(2),
    )


def offered(machine: Machine, physics=InertiaFollowsPosition) -> dict[str, Hypothesis]:
    return {h.key: h for h in physics().hypotheses(machine)}


def test_an_input_is_offered_where_the_model_has_only_another_one():
    assert set(offered(arm(), ActuatorCrosstalk)) == {"actuator_crosstalk@state:lift_rate#tail", "actuator_crosstalk@state:turn_rate#main"}
    coupled = replace(PLANT, B=B + np.array([[0, 0], [0, 0], [0, 0], [0.1, 0]]))
    assert set(offered(arm(coupled), ActuatorCrosstalk)) == {"actuator_crosstalk@state:lift_rate#tail"}


def test_it_acts_as_the_entry_of_the_matrix_and_is_stated_in_units_of_the_input_there():
    h = offered(arm(), ActuatorCrosstalk)["actuator_crosstalk@state:turn_rate#main"]
    plant, out = h.linear(PLANT, [0.6]), np.zeros(1)
    h.law(np.array([0.6]), np.array([2.0]), np.zeros(1), 0.01, out)
    assert out[0] == pytest.approx((plant.B - PLANT.B)[3, 0] * 2.0)
    assert np.count_nonzero(plant.B - PLANT.B) == 1
    assert h.parameters[0].through == (3, 1)  # 0.6 / 3: 0.2 V of the tail for a volt of the main rotor


@pytest.mark.parametrize(("rise", "bend"), [(0.3, 0.0), (-0.2, 0.25)])
def test_energy_is_kept_while_an_arm_folds(rise, bend):
    """Without forces of the model the kinetic energy of both axes stays; the inertia of the second follows the angle of the first."""
    free = replace(PLANT, A=np.where(A == 1.0, 1.0, 0.0), B=np.zeros((4, 2)))
    h = offered(arm(replace(free, A=free.A + np.diag([0, 0, 0, -1e-12]))))["inertia_follows_position@machine#turn by lift"]
    names, ratio = [p.name for p in h.parameters], 1.7
    values = np.array(h.starts[0], float)
    values[[0, 1, 2]] = rise, bend, ratio
    middle, rms = values[names.index("middle")], values[names.index("rms")]

    def energy(x):
        d = (x[0] - middle) / rms
        return 0.5 * x[1] ** 2 / ratio + 0.5 * (1 + rise * d + bend * d * d) * x[3] ** 2

    def rates(_, x):
        out = np.zeros(2)
        h.law(values, np.array([x[s.index] for s in h.reads]), np.zeros(1), 0.0, out)
        return [x[1], out[0], x[3], out[1]]

    begin = np.array([0.1, 0.4, 0.0, 0.9])
    end = solve_ivp(rates, (0, 1.5), begin, rtol=1e-10, atol=1e-12).y[:, -1]
    assert abs(end[1] - begin[1]) > 0.02
    assert energy(end) == pytest.approx(energy(begin), rel=1e-7)


def test_the_forces_of_the_model_move_the_changed_inertia():
    h = offered(arm())["inertia_follows_position@machine#turn by lift"]
    values, out = np.array(h.starts[0], float), np.zeros(2)
    values[0], x, u = 0.5, np.array([0.5, 0.0, 0.7, 0.0]), np.array([0.0, 2.0])
    h.law(values, np.array([(x if s.kind == "x" else u)[s.index] for s in h.reads]), np.zeros(1), 0.0, out)
    assert (A @ x + B @ u)[3] + out[1] == pytest.approx((A @ x + B @ u)[3] / 1.5)  # at its rms, 0.5, the inertia is 1.5 times as large
    assert out[0] == 0.0


def test_only_axes_that_turn_and_that_no_spring_joins():
    assert len(offered(arm())) == 2
    assert offered(arm(lift="mm", turn="mm")) == {}
    assert "inertia_follows_position@machine#turn by lift" in offered(arm(lift="mm"))  # a mass that slides along an arm that turns
    assert offered(replace(arm(), deflections={(0, 2): size(4, "twist", "rad")})) == {}


def test_a_force_quadratic_in_the_velocities_is_offered_for_every_pair_of_axes():
    machine = arm()
    lift, turn = machine.axes
    machine = replace(machine, axes=(lift, replace(turn, rate=replace(turn.rate, rms=1.5))))
    found = offered(machine, VelocityCoupling)
    pairs = {f"velocity_coupling@state:{a}#{law}: {b}" for a, b in (("lift_rate", "turn_rate"), ("turn_rate", "lift_rate")) for law in ("square", "product")}
    assert set(found) == pairs | {"velocity_coupling@state:lift_rate#product: tail", "velocity_coupling@state:turn_rate#product: main"}
    for law, signals, push in (("square", [-3.0], -1.8), ("product", [5.0, -3.0], 3.0)):
        h, out = found[f"velocity_coupling@state:lift_rate#{law}: turn_rate"], np.zeros(1)
        h.law(np.array([0.2]), np.array(signals), np.zeros(0), 0.01, out)
        assert out[0] == pytest.approx(push)
        assert [s.index for s in h.reads] == ([3] if law == "square" else [1, 3])
        assert h.parameters[0].scale * 1.5 * (1.5 if law == "square" else 0.5) == pytest.approx(0.1 * 2.0)
        assert h.parameters[0].unit == ("V/(rad/s)^2" if law == "square" else "V/((rad/s) (rad/s))")
    braked = found["velocity_coupling@state:lift_rate#product: tail"]
    assert [(s.kind, s.index) for s in braked.reads] == [("x", 1), ("u", 1)]
    assert set(offered(replace(arm(), axes=arm().axes[:1]), VelocityCoupling)) == {braked.key}
