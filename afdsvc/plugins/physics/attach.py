"""The ways a law is attached to a machine: to an input, to the force on an axis, to an output, or to the whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Law, Machine, Signal, Size

MOST_TERMS = 14  # of a force balance read by one law; the simulation carries 16 signals per law


def at_input(port: Size, law: Law, reads: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that changes an input; it reads the input as earlier effects left it, then ``reads``."""
    own = Signal("u", port.index)
    return _hypothesis(f"input:{port.name}", "input", law, (own, *reads), (own,), rest)


def at_force(axis: Axis, law: Law, reads: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law that adds to the acceleration of an axis."""
    return _hypothesis(f"state:{axis.rate.name}", "force", law, tuple(reads), (velocity(axis),), rest)


def at_output(port: Size, law: Law, reads: Sequence[Signal] = (), **rest: Any) -> Hypothesis:
    """Return a law that changes what a sensor says; it reads the output as earlier effects left it, then ``reads``."""
    own = Signal("y", port.index)
    return _hypothesis(f"output:{port.name}", "output", law, (own, *reads), (own,), rest)


def at_state(state: Size, law: Law, reads: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law that adds to the rate of change of a state that is no velocity."""
    return _hypothesis(f"state:{state.name}", "force", law, tuple(reads), (Signal("x", state.index),), rest)


def on_machine(stage: str, law: Law, reads: Sequence[Signal], writes: Sequence[Signal], **rest: Any) -> Hypothesis:
    """Return a law that touches the machine in several places."""
    return _hypothesis("machine", stage, law, tuple(reads), tuple(writes), rest)


def placed(machine: Machine) -> Iterator[tuple[Axis, Size]]:
    """Yield every axis whose position is a state, with that position."""
    for axis in machine.axes:
        if axis.position is not None:
            yield axis, axis.position


def state(size: Size) -> Signal:
    """A state, such as the position of an axis, to be read."""
    return Signal("x", size.index)


def velocity(axis: Axis) -> Signal:
    """The velocity of an axis, to be read, or its rate of change, to be written."""
    return Signal("x", axis.rate.index)


def balance(machine: Machine, axis: Axis) -> tuple[list[Signal], list[Coefficient]]:
    """Return the signals of the model's force balance on an axis and their coefficients as constants; none where there are over 14."""
    if machine.plant is None:
        return [], []
    x, u = machine.plant.A[axis.rate.index], machine.plant.B[axis.rate.index]
    terms = [(Signal("x", j), v) for j, v in enumerate(x) if v] + [(Signal("u", j), v) for j, v in enumerate(u) if v]
    if len(terms) > MOST_TERMS:
        return [], []
    return [signal for signal, _ in terms], [constant("nominal", "", float(v)) for _, v in terms]


def constant(name: str, unit: str, value: float) -> Coefficient:
    """Return a number of a law that no fit moves."""
    return Coefficient(name, unit, value, value, abs(value) or 1.0, nuisance=True)


def force(axis: Axis, name: str, low: float, high: float, scale: float, per: str = "", **rest: Any) -> Coefficient:
    """Return a force-like coefficient (``per`` is what it is divided by, such as "m^3"), told in the input's unit if one acts here."""
    through = None if axis.input is None else (axis.rate.index, axis.input)
    unit = axis.unit or f"{axis.rate.unit}/s"
    return Coefficient(name, f"{unit}/{per}" if per else unit, low, high, scale, through=through, **rest)


def _hypothesis(
    site: str, stage: Any, law: Law, reads: tuple[Signal, ...], writes: tuple[Signal, ...], rest: dict[str, Any]
) -> Hypothesis:
    starts = tuple(tuple(float(v) for v in s) for s in rest.pop("starts"))
    parameters = tuple(rest.pop("parameters"))
    return Hypothesis(site=site, stage=stage, law=law, reads=reads, writes=writes, parameters=parameters, starts=starts, **rest)
