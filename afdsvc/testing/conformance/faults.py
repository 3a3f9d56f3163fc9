"""Kinds of fault: applied to the gas bearing. A plugin offers ``example`` settings that make sense there."""

from __future__ import annotations

from typing import Any

import numpy as np

from afdsvc.api.control_plugins import ParameterFaultKind
from afdsvc.lti.lft import AugmentedPlant, augment
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.testing.conformance.named import settings_check, settings_of


def _augmented(thing: Any) -> AugmentedPlant:
    plant = gas_bearing()
    if isinstance(thing, ParameterFaultKind):
        return plant.faults([thing.parameter("worn", settings_of(thing))])
    return augment(plant.discrete(), [thing.direction(plant.discrete(), "worn", settings_of(thing))])


def _use(thing: Any, settings: dict[str, Any]) -> Any:
    """Hand the settings of a fault named ``worn`` to the kind of fault."""
    return thing.parameter("worn", settings) if isinstance(thing, ParameterFaultKind) else thing.direction(gas_bearing().discrete(), "worn", settings)


def severity_zero_is_the_healthy_plant(thing: Any) -> None:
    """At severity 0 the plant is the nominal one."""
    made, plant = _augmented(thing), gas_bearing().discrete()
    healthy = made.close({made.fault_names[0]: 0.0})
    far = max(float(np.abs(a - b).max()) for a, b in zip(_matrices(healthy), _matrices(plant), strict=True))
    assert far < 1e-12, f"at severity 0 a matrix of the plant is {far:.2g} off"


def a_fault_changes_the_plant(thing: Any) -> None:
    """At severity -0.5 the plant is another one, and every number of it is finite."""
    made, plant = _augmented(thing), gas_bearing().discrete()
    faulty = made.close({made.fault_names[0]: -0.5})
    assert all(np.isfinite(M).all() for M in _matrices(faulty)), "at severity -0.5 a matrix of the plant is not finite"
    change = max(float(np.abs(a - b).max()) for a, b in zip(_matrices(faulty), _matrices(plant), strict=True))
    assert change > 1e-9, "at severity -0.5 nothing has changed"


def _matrices(plant: Any) -> tuple[Any, ...]:
    return plant.A, plant.B, plant.C, plant.D


CHECKS = (settings_check(_use), severity_zero_is_the_healthy_plant, a_fault_changes_the_plant)
