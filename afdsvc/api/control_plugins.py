"""The contracts of controller and fault plugins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.lft import FaultDirection
from afdsvc.lti.statespace import StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class DesignedController:
    """A controller for one plant: its coprime factorisation with that plant and its J_K form.

    ``interconnection`` is J_K with inputs ``[y, alpha]`` and outputs ``[u, beta]``; ``description`` is one line for people.
    """

    name: str
    factorisation: Factorisation
    interconnection: StateSpace
    description: str = ""


class ControllerDesign(Protocol):
    """What a controller plugin hands out."""

    name: str
    summary: str

    def design(self, plant: StateSpace, settings: Mapping[str, Any]) -> DesignedController:
        """Return the controller for a discrete plant; raises `NotStabilising` or `BadInput` with the cure."""
        ...


class FaultKind(Protocol):
    """What a fault plugin hands out: a kind of fault that turns settings into a direction of the plant's LFT.

    Severity 0 is the identity.
    """

    name: str
    summary: str

    def direction(self, plant: StateSpace, name: str, settings: Mapping[str, Any]) -> FaultDirection:
        """Return the rank-one (or higher) direction through which the fault enters."""
        ...


@runtime_checkable
class ParameterFaultKind(Protocol):
    """A kind of fault that changes a named parameter of a physical plant; the plant itself says how that enters."""

    def parameter(self, name: str, settings: Mapping[str, Any]) -> str:
        """Return the name of the parameter that the fault ``name`` changes."""
        ...
