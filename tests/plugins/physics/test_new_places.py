"""Where forces towards an end, resistances that warm and numbers that follow a state have a place, and with which numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.explain.search.ranking import mechanism
from afdsvc.lti.statespace import StateSpace
from tests.plugins.physics.test_sites import ARM, CART, COIL, MOTOR, REACTOR, TANKS, machines, offered


def test_a_force_towards_an_end_belongs_to_lines_and_decays_within_a_third_of_the_reach():
    assert not any(k.startswith("repulsion") for k in offered(machines()[ARM]))
    q = machines()[CART].axes[0].position
    below = offered(machines()[CART])["repulsion@state:v#from below"]
    force, length, place, side = below.parameters
    assert force.linear
    assert length.high == pytest.approx(q.reach / 3)
    assert (place.low, side.low) == pytest.approx((q.mean - q.rms, -1.0))


def measured_current(voltage: str = "V", current: str = "A", through: float = 0.8):
    """A motor whose current is read, ``i = 0.8 u - 0.3 w + 0.1 v`` with a second voltage v."""
    motor = machines()[MOTOR]
    plant = StateSpace(motor.plant.A, np.array([[40.0, 5.0]]), np.array([[1.0], [-0.3]]), np.array([[0.0, 0.0], [through, 0.1]]))
    inputs = (replace(motor.inputs[0], unit=voltage), replace(motor.inputs[0], index=1, name="bias", unit="N"))
    outputs = (motor.outputs[0], replace(motor.outputs[0], index=1, name="i", unit=current, mean=3.0, rms=4.0))
    return replace(motor, plant=plant, inputs=inputs, outputs=outputs, residual=np.full(2, 0.1))


@pytest.mark.parametrize(("changes", "offers"), [({}, True), ({"voltage": "N"}, False), ({"current": "V"}, False), ({"through": 0.0}, False)])
def test_a_winding_warms_where_a_voltage_moves_a_current_that_is_read(changes, offers):
    key = "self_heating@input:voltage#i"
    found = offered(measured_current(**changes))
    assert (key in found) is offers
    if offers:
        h = found[key]
        resistance, _, size, *weights = h.parameters
        assert [(s.kind, s.index) for s in h.reads] == [("u", 0), ("x", 0), ("u", 1)]
        assert [w.low for w in weights] == [0.8, -0.3, 0.1]
        assert (resistance.high, size.low) == pytest.approx((5 / 0.8, 5.0))


@pytest.mark.parametrize(("unit", "offers"), [("A", True), ("N", False)])
def test_a_coil_warms_whose_state_is_a_current(unit, offers):
    coil = machines()[COIL]
    machine = replace(coil, states=(replace(coil.states[0], unit=unit), *coil.states[1:]))
    found = offered(machine)
    assert ("self_heating@state:i#voltage" in found) is offers
    if offers:
        assert (found["self_heating@state:i#voltage"].parameters[0].through, found["self_heating@state:i#voltage"].parameters[0].unsigned) == ((0, 0), True)


def test_numbers_of_code_follow_states_and_of_matrices_capacities_do():
    code, tanks = (
        {k: h for k, h in offered(machines()[m]).items() if h.physics == "parameter_follows_state"} for m in (REACTOR, TANKS)
    )
    assert {h.site for h in code.values()} == {"parameter:volume", "parameter:rate"}
    assert len(code) == 8
    assert {h.site for h in tanks.values()} == {"state:h1", "state:h2"}
    for found in (code, tanks):
        assert len({mechanism(h) for h in found.values()}) == len(found) / 2
        assert all(h.description for h in found.values())
    assert all(h.reads[0].index == {"state:h1": 0, "state:h2": 1}[h.site] for h in tanks.values())
