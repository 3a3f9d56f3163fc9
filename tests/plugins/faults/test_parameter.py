"""Faults of physical parameters in site files: the sampled LFT agrees with the changed physics."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.control_plugins import ParameterFaultKind
from afdsvc.app import commissioning
from afdsvc.errors import BadInput
from afdsvc.files.site import MachineSection
from afdsvc.plants.registry import plant
from afdsvc.plugins.fault_set import chosen_faults, usual_faults
from afdsvc.plugins.faults.gain import ActuatorGain, SensorGain
from afdsvc.plugins.faults.parameter import Parameter

SOFT = {"parameter": "stiffness_b_y"}
MIXED = [
    ("weak_magnet", ActuatorGain(), {"input": 3}),
    ("soft_bearing", Parameter(), SOFT),
    ("sensor", SensorGain(), {"output": 3}),
    ("current_gain_a_x", Parameter(), {}),
]


def test_mixed_faults_are_those_of_the_changed_physics() -> None:
    """Oracle: parameters changed before the plant is reduced to samples, then gains multiplied onto its columns and rows."""
    physical, faults = plant("amb_turboexpander"), chosen_faults(MIXED)
    augmented = faults.augmented(physical)
    assert augmented.fault_names == ("weak_magnet", "soft_bearing", "sensor", "current_gain_a_x")
    severities = {"weak_magnet": -0.3, "soft_bearing": -0.4, "sensor": -0.2, "current_gain_a_x": -0.5}
    v = physical.values()
    G = physical.discrete(stiffness_b_y=0.6 * v["stiffness_b_y"], current_gain_a_x=0.5 * v["current_gain_a_x"])
    B, C = G.B * [1, 1, 1, 0.7], G.C * np.array([1, 1, 1, 0.8])[:, None]
    for found in (augmented.close(severities), faults.true_plant(physical, severities)):
        for got, wanted in ((found.A, G.A), (found.B, B), (found.C, C)):
            assert np.abs(got - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize("name", ["gas_bearing", "amb_turboexpander", "unstable_second_order"])
def test_usual_faults_are_the_plants_own(name: str) -> None:
    physical = plant(name)
    assert usual_faults(physical).augmented(physical).fault_names == physical.faults().fault_names


def test_a_site_file_names_a_parameter(plugins) -> None:
    config = {"id": "b", "plant": "gas_bearing", "faults": [{"name": "soft", "kind": "parameter", "settings": {"parameter": "stiffness_hh"}}]}
    assert commissioning.commission(MachineSection(**config), plugins).augmented.fault_names == ("soft",)
    config["faults"][0]["settings"] = {"parameter": "stifness_hh"}
    with pytest.raises(BadInput, match=r"machine 'b': plant 'gas bearing.*' has no fault or parameter 'stifness_hh'; it has"):
        commissioning.commission(MachineSection(**config), plugins)


def test_refusals() -> None:
    assert isinstance(Parameter(), ParameterFaultKind)
    with pytest.raises(BadInput, match="parameter: unknown setting 'param'; known is parameter"):
        Parameter().parameter("soft", {"param": 1})
    with pytest.raises(BadInput, match="setting 'parameter' is 3; expected the name of a parameter"):
        Parameter().parameter("soft", {"parameter": 3})
    with pytest.raises(BadInput, match="'soft' of kind 'parameter' needs a machine with 'plant'"):
        Parameter().direction(plant("gas_bearing").discrete(), "soft", SOFT)
    with pytest.raises(BadInput, match="two faults change the parameter 'stiffness_b_y'"):
        chosen_faults([("a", Parameter(), SOFT), ("b", Parameter(), SOFT)]).augmented(plant("amb_turboexpander"))
