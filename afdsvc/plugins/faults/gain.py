"""Gain faults: an actuator or a sensor loses a share of its gain (severity 0 healthy, -1 total loss)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.lti.lft import FaultDirection, actuator_gain, sensor_gain
from afdsvc.lti.statespace import StateSpace


def _index(settings: Mapping[str, Any], key: str, size: int, owner: str) -> int:
    for unknown in set(settings) - {key}:
        raise BadInput(f"{owner}: unknown setting '{unknown}'; known is {key}")
    index = settings.get(key)
    if not isinstance(index, int) or not 0 <= index < size:
        raise BadInput(f"{owner}: setting '{key}' is {index!r}; expected a whole number from 0 to {size - 1}")
    return index


class ActuatorGain:
    """Setting: ``input``, the number of the plant input whose gain changes."""

    name = "actuator_gain"
    summary = "an actuator loses a share of its gain"

    def direction(self, plant: StateSpace, name: str, settings: Mapping[str, Any]) -> FaultDirection:
        """Return the direction of u_i (1 + severity)."""
        return actuator_gain(plant, name, _index(settings, "input", plant.inputs, self.name))


class SensorGain:
    """Setting: ``output``, the number of the plant output whose gain changes."""

    name = "sensor_gain"
    summary = "a sensor loses a share of its gain"

    def direction(self, plant: StateSpace, name: str, settings: Mapping[str, Any]) -> FaultDirection:
        """Return the direction of y_i (1 + severity)."""
        return sensor_gain(plant, name, _index(settings, "output", plant.outputs, self.name))
