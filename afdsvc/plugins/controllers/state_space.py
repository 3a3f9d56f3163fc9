"""Any stabilising linear controller, given by its matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.api.control_plugins import DesignedController
from afdsvc.errors import BadInput
from afdsvc.lti.coprime import controller_factorisation
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import interconnection
from afdsvc.plugins.controllers.settings import known


class Linear:
    """Settings: ``A``, ``B``, ``C``, ``D`` of K in positive feedback u = K y, at the plant's sample time."""

    name = "state_space"
    summary = "any stabilising linear controller by its matrices A, B, C, D"

    def design(self, plant: StateSpace, settings: Mapping[str, Any]) -> DesignedController:
        """Return the controller; J_K has the order of plant plus controller."""
        known(settings, self.name, "A", "B", "C", "D")
        if "D" not in settings:
            raise BadInput("state_space: setting 'D' is missing; expected the matrices A, B, C, D of the controller")
        if settings.get("A"):
            K = StateSpace.of(settings["A"], settings["B"], settings["C"], settings["D"], plant.dt)
        else:
            K = StateSpace.gain(settings["D"], plant.dt)
        fact = controller_factorisation(plant, K)
        return DesignedController(self.name, fact, interconnection(fact), f"linear controller of order {K.order}")
