"""Any rotor in magnetic bearings as a plant, whoever modelled it."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.rotor.finite_elements import Disc, Element, rotor_matrices
from afdsvc.plants.rotor.magnetic_rotor import Instrumentation, MagneticBearing, magnetic_rotor, rotor_plant
from afdsvc.plugins.controllers.lqg import Lqg

INSTRUMENTS = Instrumentation(1e-4, 0.3, 100.0, 3.0)


def spindle():
    """Return a spindle of ten elements with a disc, in two bearings, at 12,000 rpm."""
    free = rotor_matrices([Element(0.04, 0.05) for _ in range(10)], [Disc(5, 3.0, 4e-3, 7e-3)])
    bearings = [MagneticBearing("front", 2, 1, -4e5, 80.0), MagneticBearing("rear", 8, 9, -4e5, 80.0)]
    return magnetic_rotor(free, bearings, 12000)


def test_a_spindle_gets_named_faults_limits_and_speeds() -> None:
    plant = rotor_plant(spindle(), INSTRUMENTS, "spindle", balance_grade=1.0)
    assert plant.faults().fault_names[::4] == ("stiffness_front_x", "front_x_actuator", "front_x_sensor")
    assert plant.inputs[2].name == "rear_x"
    assert plant.output_cov[0, 0] == pytest.approx(0.09)
    assert np.abs(plant.unbalance).sum() > 0
    slower = plant.at_speed(0.5 * plant.speed)
    assert slower.unbalance == pytest.approx(plant.unbalance / 4)
    assert slower.name == "spindle, 8 states, 6000 rpm"
    fact = Lqg().design(plant.discrete(), {"input_weight": 1000.0}).factorisation
    assert np.abs(fact.R.poles()).max() < 1


def test_a_balance_grade_below_nothing_is_refused() -> None:
    with pytest.raises(BadInput, match="balance_grade -1 mm/s; expected 0 or more"):
        rotor_plant(spindle(), INSTRUMENTS, balance_grade=-1)
