"""The nominal model of a field trial as its owner would write it down: MODEL.toml, and Python code where the model is code."""

from __future__ import annotations

from afdsvc.lti.statespace import StateSpace
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.machines.controllers import held
from afdsvc.trial.model_text import matrices, variables

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
        A, B = held(A, B, rig.dt)
    return StateSpace(A, B, C, D)


def _parameters(rig: Rig, stated: float) -> list[str]:
    def one(value: float, loose: float) -> str:
        known = f", relative_sd = {stated * loose!r}" if stated else ""
        return f"{{value = {value!r}{known}}}"

    rows = zip(rig.names, rig.nominal, rig.loose, strict=True)
    return [f"{name} = {one(float(value), float(loose))}" for name, value, loose in rows]
