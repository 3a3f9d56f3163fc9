"""PID control of every axis by its own sensor, as magnetic bearings are run in industry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.control_plugins import DesignedController
from afdsvc.errors import BadInput
from afdsvc.lti.coprime import controller_factorisation
from afdsvc.lti.statespace import Array, StateSpace, block_diagonal
from afdsvc.lti.yjbk import interconnection
from afdsvc.plugins.controllers.settings import known

SETTINGS = ("proportional", "integral_seconds", "derivative_seconds", "filter_seconds")


class Pid:
    """Settings, each one number for all axes or one number per axis:

    ``proportional`` (input unit per output unit), ``integral_seconds`` (0 for none), ``derivative_seconds`` (0 for none) and
    ``filter_seconds``, the lag of the derivative. Input i is driven by output i alone:
    ``u = -proportional (y + integral of y / integral_seconds + derivative_seconds * filtered dy/dt)``; the minus sign makes
    positive gains restoring ones for a plant whose input moves its output forward.
    """

    name = "pid"
    summary = "PID of every axis by its own sensor"

    def design(self, plant: StateSpace, settings: Mapping[str, Any]) -> DesignedController:
        """Return the controller; J_K has the order of the plant plus one state per integrator and derivative."""
        known(settings, self.name, *SETTINGS)
        if plant.inputs != plant.outputs:
            raise BadInput(f"pid: the plant has {plant.inputs} inputs and {plant.outputs} outputs; expected one for each axis")
        if "proportional" not in settings:
            raise BadInput("pid: setting 'proportional' is missing; expected a number, or one for each axis")
        table = np.column_stack([_per_axis(settings.get(key, 0.0), key, plant.inputs) for key in SETTINGS])
        K = block_diagonal(*(pid(k, ti, td, tf, plant.dt) for k, ti, td, tf in table.tolist()))
        fact = controller_factorisation(plant, K)
        return DesignedController(self.name, fact, interconnection(fact), f"PID on {plant.inputs} axes, order {K.order}")


def pid(
    proportional: float, integral_seconds: float, derivative_seconds: float, filter_seconds: float, dt: float
) -> StateSpace:
    """Return one discrete PID from y to u; a ramp of y gives exactly ``derivative_seconds`` times its slope.

    The derivative is the difference of y and its first-order lag (with no filter time: of two samples). Raises `BadInput`
    for negative times.
    """
    if min(integral_seconds, derivative_seconds, filter_seconds) < 0:
        raise BadInput("pid: a time is negative; expected zero or positive seconds")
    poles, into, gains, direct = [], [], [], 1.0
    if integral_seconds:
        poles, into, gains = [1.0], [dt], [1 / integral_seconds]
    if derivative_seconds:
        lag = float(np.exp(-dt / filter_seconds)) if filter_seconds else 0.0
        rate = derivative_seconds * (1 - lag) / dt  # y less its lag settles at slope * dt / (1 - lag)
        poles, into, gains, direct = [*poles, lag], [*into, 1 - lag], [*gains, -rate], 1 + rate
    if not poles:
        return StateSpace.gain([[-proportional]], dt)
    k = -proportional
    return StateSpace.of(np.diag(poles), np.array([into]).T, k * np.array([gains]), [[k * direct]], dt)


def _per_axis(value: Any, key: str, axes: int) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return np.full(axes, float(array))
    if array.shape != (axes,):
        raise BadInput(f"pid: setting '{key}' has shape {array.shape}; expected a number or {axes} numbers")
    return array
