"""The faults of one physical machine: gains, parameters and kinds of third parties, pulled out together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from afdsvc.api.control_plugins import FaultKind, ParameterFaultKind
from afdsvc.api.plant import PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.lft import AugmentedPlant, FaultDirection, actuator_gain, augment, sensor_gain
from afdsvc.lti.statespace import StateSpace

Make = Callable[[StateSpace], FaultDirection]


@dataclass(frozen=True, slots=True, eq=False)
class FaultSet:
    """Faults by name: ``parameters`` maps those that change a parameter to it, ``directions`` the others to what builds
    them for a discrete plant. ``names`` is the order of all.
    """

    names: tuple[str, ...]
    parameters: Mapping[str, str] = field(default_factory=dict)
    directions: Mapping[str, Make] = field(default_factory=dict)

    def augmented(self, physical: PhysicalPlant) -> AugmentedPlant:
        """Return the discrete plant with all faults pulled out; raises `BadInput` for two faults of one parameter."""
        G, parameters = physical.discrete(), list(self.parameters.values())
        twice = sorted({p for p in parameters if parameters.count(p) > 1})
        if twice:
            raise BadInput(f"two faults change the parameter '{twice[0]}'; every parameter may appear once")
        inner = physical.faults(parameters) if parameters else augment(G, [])
        renamed = AugmentedPlant(inner.system, tuple(self.parameters), inner.widths)
        return renamed.with_directions([make(G) for make in self.directions.values()], self.names)

    def true_plant(self, physical: PhysicalPlant, severities: Mapping[str, float]) -> StateSpace:
        """Return the discrete plant with these faults present, parameters changed in the physics itself."""
        changed = {p: physical.parameters[p].value * (1 + severities.get(f, 0.0)) for f, p in self.parameters.items()}
        G = physical.discrete(**{p: v for p, v in changed.items() if v != physical.parameters[p].value})
        others = {name: severities.get(name, 0.0) for name in self.directions}
        return augment(G, [make(G) for make in self.directions.values()]).close(others)


def usual_faults(physical: PhysicalPlant) -> FaultSet:
    """Return the faults a plant is usually watched for: its own list, or a gain fault on every input and output."""
    names = physical.usual_faults or tuple(physical.fault_sites)
    if not names:
        sites = {f"{v.name}_actuator": ("input", i) for i, v in enumerate(physical.inputs)}
        sites |= {f"{v.name}_sensor": ("output", i) for i, v in enumerate(physical.outputs)}
        return FaultSet(tuple(sites), {}, {n: _gain(n, *site) for n, site in sites.items()})
    gains = {n: _gain(n, *physical.fault_sites[n]) for n in names if n in physical.fault_sites}
    return FaultSet(names, {n: n for n in names if n not in gains}, gains)


def chosen_faults(chosen: Sequence[tuple[str, FaultKind, Mapping[str, Any]]]) -> FaultSet:
    """Return the faults of a site file as (name, kind, settings); raises what a kind says about its settings."""
    parameters, directions = {}, {}
    for name, kind, settings in chosen:
        if isinstance(kind, ParameterFaultKind):
            parameters[name] = kind.parameter(name, settings)
        else:
            directions[name] = _of_kind(name, kind, settings)
    return FaultSet(tuple(name for name, _, _ in chosen), parameters, directions)


def _gain(name: str, side: str, index: int) -> Make:
    return lambda plant: (actuator_gain if side == "input" else sensor_gain)(plant, name, index)


def _of_kind(name: str, kind: FaultKind, settings: Mapping[str, Any]) -> Make:
    return lambda plant: kind.direction(plant, name, settings)
