"""The nominal model of a trial as the text of a MODEL.toml, written apart from the product's own writer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.machines.machine import TrialMachine, sampled_plant


def nominal_model_text(machine: TrialMachine, with_controller: bool = True) -> str:
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


def _sensors(machine: TrialMachine, C: Array) -> list[str]:
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


CODE = "machine.py"


def model_files(trial: FieldTrial) -> dict[str, str]:
    """Return the texts of MODEL.toml and of the code it refers to, by file name; noise is never stated."""
    rig, stated = trial.rig, trial.conditions.stated
    lines = [f'name = "{rig.family.replace("_", " ")}"']
    if rig.code:
        lines += ['time = "continuous"', *_names(rig), f'dynamics = "{CODE}:machine"', "", "[parameters]", *_parameters(rig, stated)]
        return {"MODEL.toml": "\n".join(lines) + "\n", CODE: rig.code}
    lines += [*_time(rig), *_names(rig), *matrices(_system(rig))]
    if stated and not rig.black_box:
        lines += ["", "[uncertainty]", f"relative = {stated!r}"]
    if rig.loop and rig.controller is not None:
        lines += ["", "[controller]", 'time = "discrete"', f"sample_time = {rig.dt!r}", *matrices(rig.controller)]
    return {"MODEL.toml": "\n".join(lines) + "\n"}


def _time(rig: Rig) -> list[str]:
    return ['time = "discrete"', f"sample_time = {rig.dt!r}"] if rig.black_box else ['time = "continuous"']


def _names(rig: Rig) -> list[str]:
    groups = (("inputs", rig.inputs), ("outputs", rig.outputs), ("states", rig.states))
    return [f"{key} = {variables(group)}" for key, group in groups]


def _system(rig: Rig) -> StateSpace:
    """Return the nominal matrices, sampled for a black box."""
    A, B, C, D = rig.build(rig.nominal)
    if rig.black_box:
        A, B = sampled_plant(A, B, rig.dt)
    return StateSpace(A, B, C, D)


def _parameters(rig: Rig, stated: float) -> list[str]:
    def one(value: float, loose: float) -> str:
        known = f", relative_sd = {stated * loose!r}" if stated else ""
        return f"{{value = {value!r}{known}}}"

    rows = zip(rig.names, rig.nominal, rig.loose, strict=True)
    return [f"{name} = {one(float(value), float(loose))}" for name, value, loose in rows]
