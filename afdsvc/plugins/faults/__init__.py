"""Built-in fault kinds."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.control_plugins import FaultKind
from afdsvc.plugins.faults.gain import ActuatorGain, SensorGain
from afdsvc.plugins.faults.parameter import Parameter
from afdsvc.plugins.hookspecs import hookimpl


@hookimpl
def afdsvc_faults() -> Iterable[FaultKind]:
    """Offer gain faults of actuators and sensors, and changes of physical parameters."""
    return [ActuatorGain(), SensorGain(), Parameter()]
