"""A physical plant: named parameters with units, the function that builds its matrices from them, and its limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from afdsvc.api.model import Quantity, Variable
from afdsvc.errors import BadInput
from afdsvc.lti.lft import AugmentedPlant, FaultDirection, actuator_gain, sensor_gain
from afdsvc.lti.parametric import parametric_plant
from afdsvc.lti.sampled_lft import sample_augmented
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.statespace import Array, StateSpace

Build = Callable[[Mapping[str, float]], StateSpace]


@dataclass(frozen=True, slots=True, eq=False)
class PhysicalPlant:
    """A plant built from named physical parameters.

    ``build`` turns parameter values by name into a continuous system (or a discrete one with ``sample_time``).
    ``output_cov (p, p)`` is the covariance of the measurement noise; ``process_cov (n, n)``, of the sampled plant, that
    of noise on the states or None. ``output_limit (p,)`` and ``input_limit (m,)`` are the absolute bounds of safe
    operation in the units of the signals. ``fault_sites`` names the gain faults: ``("input", i)`` or ``("output", i)``;
    ``usual_faults`` are those meant when no names are given (every gain fault if empty).
    ``recommended`` holds settings for controllers by their name, where a source gives them.

    A rotating machine has a ``speed`` [rad/s] and may have ``unbalance (m,)``: complex amplitudes per input of the force
    that turns with the rotor at that speed, in the unit of the input. ``at_speed(rad/s)`` returns the same machine, with
    the same states, at another speed; None where it is unknown.
    """

    name: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    parameters: Mapping[str, Quantity]
    build: Build
    sample_time: float
    output_cov: Array
    output_limit: Array
    input_limit: Array
    process_cov: Array | None = None
    fault_sites: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    usual_faults: tuple[str, ...] = ()
    source: str = ""
    recommended: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    speed: float = 0.0
    unbalance: Array | None = None
    at_speed: Callable[[float], PhysicalPlant] | None = None

    def values(self, changes: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the parameter values by name, some of them replaced; raises `BadInput` for an unknown name."""
        values = {name: q.value for name, q in self.parameters.items()}
        for name, value in (changes or {}).items():
            self._known(name)
            values[name] = float(value)
        return values

    def at(self, **changes: float) -> PhysicalPlant:
        """Return this plant with other parameter values."""
        values = self.values(changes)
        return replace(self, parameters={k: replace(q, value=values[k]) for k, q in self.parameters.items()})

    def continuous(self, **changes: float) -> StateSpace:
        """Return the continuous plant, some values replaced; raises `BadInput` if the plant is discrete by nature."""
        system = self.build(self.values(changes))
        if system.discrete:
            raise BadInput(f"plant '{self.name}' is discrete by nature (sample time {system.dt} s); use discrete()")
        return system

    def discrete(self, **changes: float) -> StateSpace:
        """Return the plant at its sample time, inputs held between samples, with some parameter values replaced."""
        system = self.build(self.values(changes))
        return system if system.discrete else sample_zoh(system, self.sample_time)

    def gain_faults(self, names: Sequence[str] | None = None) -> list[FaultDirection]:
        """Return gain faults of actuators and sensors as directions of the discrete plant, by name (all by default)."""
        plant = self.discrete()
        return [self._gain_fault(plant, name) for name in (self.fault_sites if names is None else names)]

    def faults(self, names: Sequence[str] | None = None) -> AugmentedPlant:
        """Return the discrete plant with faults pulled out: names of gain faults and of physical parameters, any
        mixture.

        Without names: the usual faults of this plant. A parameter's severity is its relative change, ``p = p0 (1 +
        theta)``; products of parameters are exact. A continuous plant is sampled with the feedback ``w = theta z``
        closed continuously (see `afdsvc.lti.sampled_lft`), so it agrees with sampling the changed plant to rounding.
        """
        names = list((self.usual_faults or tuple(self.fault_sites)) if names is None else names)
        continuous = self.continuous_faults(names)
        return continuous if continuous.system.discrete else sample_augmented(continuous, self.sample_time)

    def continuous_faults(self, names: Sequence[str]) -> AugmentedPlant:
        """Return the plant as built (continuous unless it is discrete by nature) with the named faults pulled out."""
        parameters = [n for n in names if n not in self.fault_sites]
        for name in parameters:
            self._known(name, "fault or parameter")
        inner = parametric_plant(self.build, self.values(), parameters)
        sites = [n for n in names if n in self.fault_sites]
        return inner.with_gain_faults({n: self.fault_sites[n] for n in sites}, names)

    def _gain_fault(self, plant: StateSpace, name: str) -> FaultDirection:
        if name not in self.fault_sites:
            raise BadInput(f"plant '{self.name}' has no gain fault '{name}'; it has {', '.join(self.fault_sites)}")
        kind, index = self.fault_sites[name]
        return actuator_gain(plant, name, index) if kind == "input" else sensor_gain(plant, name, index)

    def _known(self, name: str, what: str = "parameter") -> None:
        if name not in self.parameters:
            known = [*(self.fault_sites if what != "parameter" else ()), *self.parameters]
            raise BadInput(f"plant '{self.name}' has no {what} '{name}'; it has {', '.join(known)}")
