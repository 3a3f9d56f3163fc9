"""Faults of physical parameters: a bearing's stiffness, a damping, a mass changes by a share of its value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from afdsvc.errors import BadInput
from afdsvc.lti.lft import FaultDirection
from afdsvc.lti.statespace import StateSpace


class Parameter:
    """Setting: ``parameter``, the name of a parameter of the machine's physical plant; the fault's own name by default.

    Severity -0.2 is a parameter at 80 % of its value. Several of them are pulled out together, products included.
    """

    name = "parameter"
    summary = "a physical parameter of the plant loses a share of its value"

    def parameter(self, name: str, settings: Mapping[str, Any]) -> str:
        """Return which parameter the fault ``name`` changes; raises `BadInput` for settings that do not say it."""
        for unknown in set(settings) - {"parameter"}:
            raise BadInput(f"{self.name}: unknown setting '{unknown}'; known is parameter")
        chosen = settings.get("parameter", name)
        if not isinstance(chosen, str):
            raise BadInput(f"{self.name}: setting 'parameter' is {chosen!r}; expected the name of a parameter")
        return chosen

    def direction(self, plant: StateSpace, name: str, settings: Mapping[str, Any]) -> FaultDirection:
        """Matrices alone do not tell what a parameter does to them: always raises `BadInput`."""
        raise BadInput(f"fault '{name}' of kind 'parameter' needs a machine with 'plant', whose parameters have names")
