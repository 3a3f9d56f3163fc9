"""The ways a law is attached to a machine: to an input, to the force on an axis, to an output, to a parameter, or to the whole."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Law, Machine, Signal, Size
from afdsvc.dataset.units import parsed_unit, unit_registry
from afdsvc.lti.statespace import StateSpace

MOST = 100  # periods per turn of what repeats along a way
MOST_TERMS = 14  # of a force balance read by one law; the simulation carries 16 signals per law
_QUANTITIES = (
    ("length", "m"), ("angle", "radian"), ("velocity", "m/s"), ("velocity", "radian/s"), ("force", "N"), ("force", "N*m"), ("current", "A"), ("voltage", "V"),
)


def at_input(port: Size, law: Law, reads: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that changes an input; it reads the input as earlier effects left it, then ``reads``."""
    own = Signal("u", port.index)
    return _hypothesis(f"input:{port.name}", "input", law, (own, *reads), (own,), rest)


def at_force(axis: Axis, law: Law, reads: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law that adds to the acceleration of an axis."""
    return _hypothesis(f"state:{axis.rate.name}", "force", law, tuple(reads), (velocity(axis),), rest)


def at_drive(axis: Axis, machine: Machine, law: Law, reads: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law about the input that drives an axis, added to the acceleration it causes there; for laws that also read states."""
    return _hypothesis(f"input:{machine.inputs[axis.input or 0].name}", "force", law, tuple(reads), (velocity(axis),), rest)


def at_output(port: Size, law: Law, reads: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that changes what a sensor says; it reads the output as earlier effects left it, then ``reads``."""
    own = Signal("y", port.index)
    return _hypothesis(f"output:{port.name}", "output", law, (own, *reads), (own,), rest)


def at_state(where: Size, law: Law, reads: Sequence[Signal], writes: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that adds to the rate of change of a state that is not a velocity, or of those in ``writes``."""
    return _hypothesis(f"state:{where.name}", "force", law, tuple(reads), tuple(writes) or (state(where),), rest)


def at_parameter(number: Size, law: Law, reads: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that changes a parameter of Python code; it reads the parameter as earlier effects left it, then ``reads``."""
    own = Signal("p", number.index)
    return _hypothesis(f"parameter:{number.name}", "parameter", law, (own, *reads), (own,), rest)


def at_machine(stage: str, law: Law, reads: Sequence[Signal], writes: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law that touches the machine in several places."""
    return _hypothesis("machine", stage, law, tuple(reads), tuple(writes), rest)


def placed(machine: Machine) -> Iterator[tuple[Axis, Size]]:
    """Yield every axis whose position is a state, with that position."""
    for axis in machine.axes:
        if axis.position is not None:
            yield axis, axis.position


def converter(machine: Machine, axis: Axis) -> Size | None:
    """Return the state that drives an axis on which no input acts at once, such as a current: of those of no axis the one that pushes most."""
    if machine.plant is None or axis.input is not None:
        return None
    moving, row = _moving(machine), machine.plant.A[axis.rate.index]
    return max((s for s in machine.states if s.index not in moving and row[s.index]), key=lambda s: abs(row[s.index]) * s.rms, default=None)


def _moving(machine: Machine) -> set[int]:
    """Return the numbers of the states that belong to an axis."""
    return {s.index for a in machine.axes for s in (a.rate, a.position) if s is not None}


def stored(machine: Machine) -> list[Size]:
    """Return the states that belong to no axis, such as currents, voltages, temperatures and levels."""
    moving = _moving(machine)
    return [s for s in machine.states if s.index not in moving]


def decaying(machine: Machine) -> list[tuple[Size, float]]:
    """Return the states that belong to no axis and decay by themselves, with the rate at which they do."""
    if machine.plant is None:
        return []
    own = -np.diag(machine.plant.A)
    return [(s, float(own[s.index])) for s in stored(machine) if own[s.index] > 0]


def store_states(machine: Machine) -> list[Size]:
    """Return the states that store something: they decay by themselves, and what leaves one arrives in others: no other entry of row and column is below zero."""
    if machine.plant is None:
        return []
    A = machine.plant.A
    return [s for s, _ in decaying(machine) if min(np.delete([*A[s.index], *A[:, s.index]], [s.index, s.index + len(A)]), default=0.0) >= 0]


def downstream(machine: Machine, store: Size) -> list[tuple[int, float]]:
    """Return the states in which arrives what leaves a store, and how much per unit lost."""
    if machine.plant is None:
        return []
    column = machine.plant.A[:, store.index]
    return [(int(i), float(-column[i] / column[store.index])) for i in np.flatnonzero(column) if i != store.index]


def state(size: Size) -> Signal:
    """A state, such as the position of an axis, to be read."""
    return Signal("x", size.index)


def velocity(axis: Axis) -> Signal:
    """The velocity of an axis, to be read, or its rate of change, to be written."""
    return Signal("x", axis.rate.index)


def balance(machine: Machine, moved: Size) -> tuple[list[Signal], list[Coefficient]]:
    """Return the signals of which the model makes the rate of change of a state, itself first, and their coefficients as constants; none where there are over 14."""
    if machine.plant is None:
        return [], []
    x, u = machine.plant.A[moved.index], machine.plant.B[moved.index]
    own = moved.index
    terms = [(Signal("x", j), float(x[j])) for j in sorted(range(len(x)), key=lambda j: j != own) if x[j]] + [(Signal("u", j), float(v)) for j, v in enumerate(u) if v]
    if len(terms) > MOST_TERMS:
        return [], []
    return [signal for signal, _ in terms], [constant("nominal", "", v) for _, v in terms]


def input_followers(machine: Machine) -> Iterator[tuple[Size, list[Signal], list[Coefficient]]]:
    """Yield every state that does nothing but follow an input, with what `balance` returns."""
    for x in machine.states:
        reads, constants = balance(machine, x)
        if len(reads) == 2 and reads[0] == state(x) and reads[1].kind == "u":
            yield x, reads, constants


NONE = 1e-6  # share of the largest force on an axis below which the model has no force of a kind


def in_proportion(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """``-k z``."""
    out[0] -= p[0] * z[0]


def at_missing(machine: Machine, axis: Axis, own: Size, what: str, **rest: Any) -> Iterator[Hypothesis]:
    """Yield a force on an axis in proportion to its position or velocity, ``what`` per unit of it, where the model has none."""
    if machine.plant is None or abs(machine.plant.A[axis.rate.index, own.index]) * own.rms > NONE * axis.push:
        return
    scale = 0.05 * axis.push / own.rms
    yield at_force(
        axis, in_proportion, [state(own)], starts=[(0.0,)], linear=lambda plant, values: _resisted(plant, values, axis.rate.index, own.index),
        parameters=[force(axis, what, -200 * scale, 200 * scale, scale, own.unit, linear=True)], **rest,
    )


def _resisted(plant: StateSpace, values: Sequence[float], row: int, column: int) -> StateSpace:
    A = plant.A.copy()
    A[row, column] -= values[0]
    return StateSpace(A, plant.B, plant.C, plant.D, plant.dt)


def constant(name: str, unit: str, value: float) -> Coefficient:
    """Return a number of a law that no fit moves."""
    return Coefficient(name, unit, value, value, abs(value) or 1.0, nuisance=True)


def operating_point(where: Size) -> Coefficient:
    """Return the mean of a signal: where it has one sign, the model is the tangent of a curved law there."""
    return constant("operating point", where.unit, where.mean)


def motion(axis: Axis) -> str:
    """Return the unit of what the velocity of an axis sums up to."""
    if axis.position is not None:
        return axis.position.unit
    return summed(axis.rate.unit)


def summed(unit: str) -> str:
    """Return the unit of what a signal sums up to over time."""
    return unit.removesuffix("/s") if unit.endswith("/s") else f"({unit}) s" if unit else "s"


def imposed(machine: Machine, kind: str) -> Iterator[tuple[Size, Size, float, float]]:
    """Yield every output that is a force with every input of a kind of motion, and the range -1 to 1 of the sign the model gives it."""
    for y, u in product(machine.outputs, machine.inputs):
        if quantity(y.unit) == "force" and quantity(u.unit) == kind:
            static = _static(machine.plant, y.index, u.index)
            yield y, u, -1.0 if static <= 0 else 0.0, 1.0 if static >= 0 else 0.0


def _static(plant: StateSpace | None, i: int, j: int) -> float:
    """Return the gain at frequency zero, 0 where there is none."""
    if plant is None or np.linalg.matrix_rank(plant.A) < plant.order:
        return 0.0
    return float(plant.D[i, j] - plant.C[i] @ np.linalg.solve(plant.A, plant.B[:, j]))


@lru_cache(maxsize=256)
def quantity(unit: str) -> str:
    """Return what a unit measures: "length", "angle", "velocity" (of either), "force" (or torque), "current", "voltage", else ""."""
    known = parsed_unit(unit)
    if known is None:
        return ""
    turning = any(word in str(known) for word in ("radian", "degree", "turn", "revolution"))
    for kind, example in _QUANTITIES:
        if known.dimensionality == unit_registry().Unit(example).dimensionality and turning == ("radian" in example):
            return kind
    return ""


def radians(unit: str) -> float:
    """Return how many radians one unit of an angle is."""
    return float(unit_registry().Quantity(1.0, unit).to("radian").magnitude)


def radians_per_second(unit: str) -> float:
    """Return how many rad/s one unit of an angular velocity is, 0 for anything else."""
    turns = quantity(unit) == "velocity" and quantity(f"({unit}) * s") == "angle"
    return float(unit_registry().Quantity(1.0, unit).to("radian/second").magnitude) if turns else 0.0


def least_wave(way: Size) -> float:
    """Return the wave number [rad per unit] of which a way holds two periods, infinite where nothing moves.

    In fewer a wave shows no repetition: it stands for any smooth curve.
    """
    half = max(way.peak - abs(way.mean), 0.1 * way.peak)  # of the way travelled, about its mean
    return 2 * math.pi / half if half > 0 else math.inf


def orders(speed: float, dt: float) -> list[float]:
    """Return the whole numbers of periods per turn that samples every ``dt`` s resolve at a speed [rad/s], `MOST` at most."""
    return [float(n) for n in range(1, 1 + min(MOST, int(math.pi / (speed * dt))))]


def turn_periods(unit: float) -> tuple[Coefficient, Coefficient]:
    """Return the parameters of what repeats along a way: its periods per turn, and the constant ``unit``, radians (per second) in one unit."""
    return Coefficient("periods per turn", "", 0.5, 2.0 * MOST, 1e-3), Coefficient("radians", "", unit, unit, unit, nuisance=True)


def force(axis: Axis, name: str, low: float, high: float, scale: float, per: str = "", **rest: Any) -> Coefficient:
    """Return a force-like coefficient (``per`` is its denominator, such as "m^3"), in the unit of the input where one acts here."""
    through = None if axis.input is None else (axis.rate.index, axis.input)
    unit = axis.unit or f"{axis.rate.unit}/s"
    return Coefficient(name, f"{unit}/{per}" if per else unit, low, high, scale, through=through, unsigned=True, **rest)


def unknown_force(axis: Axis) -> Coefficient:
    """Return a constant force of any size: the balance at an operating point that the model does not have."""
    return force(axis, "constant", -10 * axis.push, 10 * axis.push, 0.1 * axis.push, linear=True, nuisance=True)


def _hypothesis(
    site: str, stage: Any, law: Law, reads: tuple[Signal, ...], writes: tuple[Signal, ...], rest: dict[str, Any]
) -> Hypothesis:
    starts = tuple(tuple(float(v) for v in s) for s in rest.pop("starts"))
    parameters = tuple(rest.pop("parameters"))
    return Hypothesis(site=site, stage=stage, law=law, reads=reads, writes=writes, parameters=parameters, starts=starts, **rest)
