"""Parameter change: no new physics, but a parameter of the model that differs by more than its stated uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afdsvc.api.physics import Axis, Coefficient, Hypothesis, Machine, Signal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.attach import at_force, at_input, at_output, at_parameter, balance, constant, placed

IntArray = NDArray[np.int64]
LOWEST = {"stiffness": -0.99, "damping": -3.0}  # a machine may be driven by what should damp it
GAINS = "product of actuator gain and sensor gain"
_REFUTED = "a residual at unexcited lines, or one whose share changes with the level"


def gain(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A signal ``1 + c`` times as large."""
    out[0] += p[0] * z[0]


def terms(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """Terms of the force balance ``1 + c`` times as large; ``p[1:]`` are their nominal coefficients."""
    total = 0.0
    for k in range(len(z)):
        total += p[1 + k] * z[k]
    out[0] += p[0] * total


def inertia(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A mass ``1 + c`` times as large: every acceleration divided by that; ``p[1:]`` are the nominal coefficients."""
    total = 0.0
    for k in range(len(z)):
        total += p[1 + k] * z[k]
    out[0] -= total * p[0] / (1 + p[0])


class ParameterChange:
    """Gain of every input and output, and stiffness, damping and mass of every axis."""

    name = "parameter_change"
    summary = "a parameter of the model that is off by more than its stated uncertainty"

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per parameter and place."""
        for port in machine.inputs:
            yield at_input(
                port, gain, **self._parts("actuator gain", []),
                linear=lambda plant, values, column=port.index: _scaled_input(plant, values, column),
            )
        for port in machine.outputs:
            yield at_output(
                port, gain, **self._parts("sensor gain", []),
                linear=lambda plant, values, row=port.index: _scaled_output(plant, values, row),
            )
        for axis in machine.axes if machine.plant is not None else ():
            yield from self._of_axis(axis, machine)

    def over_time(self, machine: Machine) -> Iterator[Hypothesis]:
        """Yield the numbers that may change with time: of code its parameters and gains, of matrices those above.

        None while a machine only decays, without inputs or after a step: time and amplitude are one.
        """
        if not machine.driven:
            return
        for h in self.hypotheses(machine):
            if not (machine.code and h.stage == "force"):
                yield replace(h, notes={k: v for k, v in h.notes.items() if k != "gauge"})
        for number in machine.parameters:
            yield at_parameter(number, gain, **self._parts("change", []) | {"notes": {"variant": number.name, "of": number.name}})

    def _of_axis(self, axis: Axis, machine: Machine) -> Iterable[Hypothesis]:
        assert machine.plant is not None  # noqa: S101
        row = machine.plant.A[axis.rate.index]
        for name, own, columns in (
            ("stiffness", axis.position, [q for _, q in placed(machine)]),
            ("damping", axis.rate, [a.rate for a in machine.axes]),
        ):
            if own is None:
                continue
            coupled = [s.index for s in columns if row[s.index] != 0]
            if row[own.index] != 0:
                yield self._of_terms(axis, row, name, [own.index], name)
            if row[own.index] != 0 and len(coupled) > 1:  # what makes them may be one thing for all axes
                yield self._of_terms(axis, row, name, coupled, f"{name} with its couplings")
        reads, constants = balance(machine, axis.rate)
        if reads:
            states, ports = (np.array([s.index for s in reads if s.kind == kind], dtype=np.int64) for kind in "xu")
            yield at_force(
                axis, inertia, reads, **self._parts("mass", [c.low for c in constants], -0.9),
                linear=lambda plant, values, i=axis.rate.index: _scaled_row(plant, values, i, states, ports),
            )

    def _of_terms(self, axis: Axis, row: NDArray[np.float64], name: str, columns: Sequence[int], variant: str) -> Hypothesis:
        states = np.array(columns)
        return at_force(
            axis, terms, [Signal("x", int(j)) for j in states],
            **self._parts(name, [float(v) for v in row[states]], LOWEST[name], variant),
            linear=lambda plant, values: _scaled_entries(plant, values, axis.rate.index, states),
        )

    def _parts(self, what: str, fixed: Sequence[float], low: float = -0.999, variant: str = "") -> dict[str, Any]:
        constants = [constant("nominal", "", v) for v in fixed]
        return {
            "physics": self.name, "family": "gain",
            "notes": {"variant": variant or what, "of": what} | ({"gauge": GAINS} if what.endswith("gain") else {}),
            "parameters": [Coefficient(what, "", low, 30.0, 0.02, linear=True), *constants],
            "starts": [(0.0, *fixed)],
            "predicts": "a linear residual in fixed proportion to what the model says at every level",
            "refuted_by": _REFUTED,
        }


def _scaled_input(plant: StateSpace, values: Sequence[float], column: int) -> StateSpace:
    T = np.eye(plant.inputs)
    T[column, column] += values[0]
    return StateSpace(plant.A, plant.B @ T, plant.C, plant.D @ T, plant.dt)


def _scaled_output(plant: StateSpace, values: Sequence[float], row: int) -> StateSpace:
    T = np.eye(plant.outputs)
    T[row, row] += values[0]
    return StateSpace(plant.A, plant.B, T @ plant.C, T @ plant.D, plant.dt)


def _scaled_entries(plant: StateSpace, values: Sequence[float], i: int, states: IntArray) -> StateSpace:
    A = plant.A.copy()
    A[i, states] += values[0] * np.asarray(values[1:])
    return StateSpace(A, plant.B, plant.C, plant.D, plant.dt)


def _scaled_row(plant: StateSpace, values: Sequence[float], i: int, states: IntArray, ports: IntArray) -> StateSpace:
    """Return the plant with what `inertia` takes from row ``i``: a share of the nominal terms, wherever the row's own are."""
    A, B = plant.A.copy(), plant.B.copy()
    lost = np.asarray(values[1:]) * values[0] / (1 + values[0])
    A[i, states] -= lost[: len(states)]
    B[i, ports] -= lost[len(states) :]
    return StateSpace(A, B, plant.C, plant.D, plant.dt)
