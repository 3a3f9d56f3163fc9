"""A rotor on radial magnetic bearings as a plant: control currents in, displacements beside the bearings out.

The force of a bearing axis is ``f = K_i i - K s`` [N] with the control current i [A], the displacement s [m] at the
bearing, the current gain K_i [N/A] and the bearing stiffness K [N/m], which is negative for a magnetic bearing: without
control the rotor falls to one side. Displacements are read at other nodes than those the forces act at.

Every stiffness and current gain is a named parameter. What a change of it does to the full model (a force at its node)
is carried into the small model by the transformation that made it; P1 eqs. 48-52, with the column of the bearing alone
in place of the whole column of A, which holds the stiffness of the shaft too. Source: publication P1 of A. K. Sekunda,
"Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, Technical University of Denmark, 2017.

Any rotor in magnetic bearings as a plant: named parameters, gain faults of every axis, limits, unbalance, any speed.

A rotor modelled with ROSS gets here through `afdsvc.plants.rotor.ross.rotor_from_ross` and
`afdsvc.plants.rotor.magnetic_rotor.magnetic_rotor`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from afdsvc.api.model import Quantity, Variable
from afdsvc.api.plant import Build, PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants.rotor.finite_elements import AXES, RotorMatrices
from afdsvc.plants.rotor.modes import FullRotor, ModalBasis, full_rotor, slowest_modes

MICROMETRES = 1e6  # per metre


@dataclass(frozen=True, slots=True)
class MagneticBearing:
    """A radial bearing: its name, the nodes of actuator and sensor, K [N/m] (negative) and K_i [N/A] of both axes."""

    name: str
    node: int
    sensor: int
    stiffness: float
    current_gain: float


@dataclass(frozen=True, slots=True, eq=False)
class MagneticRotor:
    """A rotor in its bearings at one speed [rad/s]; channels are ordered by bearing, then x and y."""

    rotor: RotorMatrices
    bearings: tuple[MagneticBearing, ...]
    speed: float

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the axes: ``a_x, a_y, b_x, b_y`` for bearings a and b."""
        return tuple(f"{b.name}_{axis}" for b in self.bearings for axis in AXES)

    def parameters(self) -> dict[str, Quantity]:
        """Return stiffness and current gain of every axis, and the speed, by name."""
        axes = [(f"{b.name}_{axis}", b) for b in self.bearings for axis in AXES]
        stiffness = {f"stiffness_{name}": Quantity(b.stiffness, "N/m") for name, b in axes}
        gains = {f"current_gain_{name}": Quantity(b.current_gain, "N/A") for name, b in axes}
        return {**stiffness, **gains, "speed": Quantity(self.speed, "rad/s")}

    def full(self, values: Mapping[str, float]) -> FullRotor:
        """Return all the rotor's states with these parameter values."""
        at = self._directions([b.node for b in self.bearings])
        K = np.array([values[f"stiffness_{name}"] for name in self.channels])
        return full_rotor(self.rotor, values["speed"], at.T @ (K[:, None] * at))

    def full_system(self, values: Mapping[str, float]) -> StateSpace:
        """Return the full model from currents [A] to displacements [um]: the 320 states of 40 nodes."""
        full = self.full(values)
        return StateSpace.of(full.A, self._forces(full) * self._gains(values), self._readings(full))

    def reduced(self, values: Mapping[str, float], states: int) -> StateSpace:
        """Return the small model made of the full one with these very values; its states change with the values."""
        full = self.full(values)
        C = self._readings(full)
        basis = slowest_modes(full, states, C)
        B = self._forces(full) * self._gains(values)
        return StateSpace.of(basis.left @ full.A @ basis.right, basis.left @ B, C @ basis.right)

    def family(self, states: int) -> tuple[Build, ModalBasis]:
        """Return the small model as a function of its parameters, and the basis; the states are those of nominal values.

        The speed enters linearly, through the gyroscopic matrix carried into the basis of the nominal speed.
        """
        nominal = {name: q.value for name, q in self.parameters().items()}
        full = self.full(nominal)
        readings = self._readings(full)
        basis = slowest_modes(full, states, readings)
        A, C = basis.left @ full.A @ basis.right, readings @ basis.right
        pushes = basis.left @ self._forces(full)  # of a force on every bearing axis
        moves = self._positions(full) @ basis.right  # displacement of every bearing axis
        gyroscopic = basis.left @ (self.full({**nominal, "speed": self.speed + 1.0}).A - full.A) @ basis.right

        def build(values: Mapping[str, float]) -> StateSpace:
            change = np.array([values[n] - nominal[n] for n in (f"stiffness_{name}" for name in self.channels)])
            turned = A + (values["speed"] - nominal["speed"]) * gyroscopic
            return StateSpace.of(turned - (pushes * change) @ moves, pushes * self._gains(values), C)

        return build, basis

    def unbalance(self, grade: float) -> Array:
        """Return the complex currents ``(channels,)`` that act like unbalance of ISO 21940 grade G ``grade`` [mm/s].

        ``grade / speed`` is the eccentricity of the rotor's mass, shared by the bearings; at the angle ``speed t`` the force
        turns with the rotor. Zero at standstill. At another speed the same rotor's force goes with the square of the speed.
        """
        force = self.rotor.total_mass() * grade * 1e-3 * abs(self.speed) / len(self.bearings)
        return np.array([force / b.current_gain * turn for b in self.bearings for turn in (1.0, -1j)])

    def at_speed(self, rpm: float) -> MagneticRotor:
        """Return the same rotor at another speed."""
        return replace(self, speed=2 * np.pi * rpm / 60)

    def _gains(self, values: Mapping[str, float]) -> Array:
        return np.array([values[f"current_gain_{name}"] for name in self.channels])

    def _directions(self, nodes: Sequence[int]) -> Array:
        return np.array([self.rotor.direction(node, axis) for node in nodes for axis in range(len(AXES))])

    def _forces(self, full: FullRotor) -> Array:
        return np.array([full.force(d) for d in self._directions([b.node for b in self.bearings])]).T

    def _positions(self, full: FullRotor) -> Array:
        return np.array([full.reading(d) for d in self._directions([b.node for b in self.bearings])])

    def _readings(self, full: FullRotor) -> Array:
        return MICROMETRES * np.array([full.reading(d) for d in self._directions([b.sensor for b in self.bearings])])


def magnetic_rotor(rotor: RotorMatrices, bearings: Sequence[MagneticBearing], rpm: float) -> MagneticRotor:
    """Return a rotor in its bearings; raises `BadInput` for repeated names, and nodes or gains that cannot be."""
    names = [b.name for b in bearings]
    if not names or len(set(names)) < len(names):
        raise BadInput(f"bearings are named {', '.join(names) or 'not at all'}; expected different names")
    for b in bearings:
        rotor.direction(b.node, 0), rotor.direction(b.sensor, 0)
        if not b.current_gain:
            raise BadInput(f"bearing '{b.name}' has a current gain of 0 N/A; then nothing can hold the rotor")
    return MagneticRotor(rotor, tuple(bearings), 2 * np.pi * rpm / 60)


def _state_variables(count: int) -> tuple[Variable, ...]:
    """Return the modal states; each moves the sensors by one micrometre."""
    return tuple(Variable(f"mode_{i + 1}", "um") for i in range(count))


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
        states=_state_variables(states),
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
