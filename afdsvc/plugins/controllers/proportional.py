"""Proportional output feedback."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.control_plugins import DesignedController
from afdsvc.errors import BadInput
from afdsvc.lti.coprime import proportional_factorisation
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.lti.yjbk import interconnection
from afdsvc.plugins.controllers.lqg import lqg_gains
from afdsvc.plugins.controllers.settings import known


class Proportional:
    """Settings: ``gain``, a number (times the identity) or an ``inputs x outputs`` matrix, in positive feedback u = K y.

    The fictitious state feedback F of the factorisation is the LQ gain of the `lqg` controller with the same weights.
    """

    name = "proportional"
    summary = "proportional output feedback u = K y"

    def design(self, plant: StateSpace, settings: Mapping[str, Any]) -> DesignedController:
        """Return the controller; J_K has the order of the plant."""
        weights = ("state_weight", "input_weight", "process_weight", "noise_weight")
        known(settings, self.name, "gain", *weights)
        P = _gain(settings.get("gain"), plant)
        F, _ = lqg_gains(plant, {k: v for k, v in settings.items() if k != "gain"})
        fact = proportional_factorisation(plant, P, F)
        return DesignedController(self.name, fact, interconnection(fact), f"proportional feedback {P.tolist()}")


def _gain(value: Any, plant: StateSpace) -> Array:
    if value is None:
        raise BadInput("proportional: setting 'gain' is missing; expected a number or a matrix")
    gain = np.asarray(value, dtype=float)
    shape = (plant.inputs, plant.outputs)
    if gain.ndim == 0 and shape[0] == shape[1]:
        return float(gain) * np.eye(shape[0])
    if gain.shape != shape:
        raise BadInput(f"proportional: setting 'gain' has shape {gain.shape}; expected a number or shape {shape}")
    return gain
