"""The nominal model of a trial as the text of a MODEL.toml, written apart from the product's own writer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.trial.machines.machine import Machine


def model_text(machine: Machine, with_controller: bool = True) -> str:
    """Return the nominal matrices, what their owner knows of them, the noise, and the controller where it is known."""
    A, B, C = machine.matrices(machine.nominal)
    lines = [
        f'name = "{machine.name}"',
        'time = "continuous"',
        f"inputs = {variables(machine.inputs)}",
        f"outputs = {variables(machine.outputs)}",
        f"states = {variables(machine.states)}",
        *matrices(StateSpace(A, B, C, np.zeros((C.shape[0], B.shape[1])))),
        "",
        "[uncertainty]",
        f"relative = {float(machine.theta_sd.max())!r}",
        *_sensors(machine, C),
        "",
        "[noise]",
        f"output_sd = {_row(machine.sigma)}",
    ]
    if with_controller:
        lines += ["", "[controller]", 'time = "discrete"', f"sample_time = {machine.dt!r}", *matrices(machine.controller)]
    return "\n".join(lines) + "\n"


def _sensors(machine: Machine, C: Array) -> list[str]:
    """Return the standard deviations of C: entries of 1 count as exact unless their owner says otherwise."""
    known = machine.theta_sd[-C.shape[0] :]
    return [f"C = {_rows(np.abs(C) * known[:, None])}"] if known.any() else []


def variables(named: Sequence[Variable]) -> str:
    """Return variables as a TOML list of names, units and rates."""
    def one(v: Variable) -> str:
        rate = f', rate_of = "{v.rate_of}"' if v.rate_of else ""
        return f'{{name = "{v.name}", unit = "{v.unit}"{rate}}}'

    return f"[{', '.join(one(v) for v in named)}]"


def matrices(system: StateSpace) -> list[str]:
    """Return A, B, C, D as lines of TOML."""
    pairs = zip("ABCD", (system.A, system.B, system.C, system.D), strict=True)
    return [f"{name} = {_rows(matrix)}" for name, matrix in pairs]


def _rows(matrix: Array) -> str:
    return f"[{', '.join(_row(row) for row in matrix)}]"


def _row(row: Array) -> str:
    return f"[{', '.join(repr(float(x)) for x in row)}]"
