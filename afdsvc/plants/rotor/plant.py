"""Any rotor in magnetic bearings as a plant: named parameters, gain faults of every axis, limits, unbalance, any speed.

A rotor modelled with ROSS gets here through `afdsvc.plants.rotor.ross.rotor_from_ross` and
`afdsvc.plants.rotor.magnetic_rotor.magnetic_rotor`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array
from afdsvc.plants.rotor.magnetic_rotor import MagneticRotor
from afdsvc.plants.rotor.magnetic_rotor import states as modal_states


@dataclass(frozen=True, slots=True)
class Instrumentation:
    """How the rotor is measured and held: sample time [s], sensor noise (standard deviation) [um], largest displacement
    [um] and control current [A] that do no harm."""

    sample_time: float
    noise_sd: float
    displacement_limit: float
    current_limit: float


def rotor_plant(
    rotor: MagneticRotor,
    instruments: Instrumentation,
    name: str = "rotor on magnetic bearings",
    states: int = 8,
    balance_grade: float = 0.0,
    source: str = "",
    recommended: Mapping[str, Mapping[str, Any]] | None = None,
) -> PhysicalPlant:
    """Return the rotor reduced to ``states`` modes, at the speed it was made for; currents [A] in, displacements [um] out.

    Faults: ``stiffness_AXIS``, ``AXIS_actuator``, ``AXIS_sensor`` for every axis; parameters besides: ``current_gain_AXIS``
    and ``speed``. ``balance_grade`` [mm/s] is that of ISO 21940 at this speed. Raises `BadInput` for a number of states that
    splits a pair of modes.
    """
    if not 0 <= balance_grade < float("inf"):
        raise BadInput(f"balance_grade {balance_grade} mm/s; expected 0 or more")
    build, _ = rotor.family(states)
    axes = rotor.channels
    sites = {f"{n}_actuator": ("input", i) for i, n in enumerate(axes)}
    sites |= {f"{n}_sensor": ("output", i) for i, n in enumerate(axes)}
    plant = PhysicalPlant(
        name=f"{name}, {states} states",
        inputs=tuple(Variable(axis, "A") for axis in axes),
        outputs=tuple(Variable(axis, "um") for axis in axes),
        states=modal_states(states),
        parameters=rotor.parameters(),
        build=build,
        sample_time=instruments.sample_time,
        output_cov=instruments.noise_sd**2 * np.eye(len(axes)),
        output_limit=np.full(len(axes), instruments.displacement_limit),
        input_limit=np.full(len(axes), instruments.current_limit),
        fault_sites=sites,
        usual_faults=(*(f"stiffness_{n}" for n in axes), *sites),
        source=source,
        recommended=recommended or {},
    )
    return _at_speed(rotor.unbalance(balance_grade), rotor.speed, plant, rotor.speed)


def _at_speed(unbalance: Array, balanced_at: float, plant: PhysicalPlant, speed: float) -> PhysicalPlant:
    """Return the plant turning at ``speed`` [rad/s]; its unbalance was that at ``balanced_at``."""
    ratio = speed / balanced_at if balanced_at else 0.0
    turning = plant if speed == plant.parameters["speed"].value else plant.at(speed=speed)
    return replace(
        turning, name=f"{plant.name}, {speed * 30 / np.pi:g} rpm", speed=speed, unbalance=unbalance * ratio**2,
        at_speed=partial(_at_speed, unbalance, balanced_at, plant),
    )
