"""A trial on disk: the model and the recordings, and the answer sealed apart from them.

The nominal model is written as the text of a MODEL.toml, apart from the product's own writer. The seal is a commitment that goes
with the recordings: the SHA-256 of a random nonce, the answer and the digests of the trial's files. Whoever holds the folder
cannot read the answer out of it; whoever holds the answer cannot change it, or the recordings, afterwards.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.trial.answer import FieldAnswer, TrialAnswer
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.generate import BlindTrial
from afdsvc.trial.machine import TrialMachine, sampled_plant


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
        lines += ['time = "continuous"', *_names(rig), f'dynamics = "{CODE}:machine"', "", "[parameters]", *_parameter_lines(rig, stated)]
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


def _parameter_lines(rig: Rig, stated: float) -> list[str]:
    def one(value: float, loose: float) -> str:
        known = f", relative_sd = {stated * loose!r}" if stated else ""
        return f"{{value = {value!r}{known}}}"

    rows = zip(rig.names, rig.nominal, rig.loose, strict=True)
    return [f"{name} = {one(float(value), float(loose))}" for name, value, loose in rows]


FORMATS = ("npz", "csv")


@dataclass(frozen=True, slots=True)
class TrialPaths:
    """Where the parts of a trial are: what `explain` is given."""

    model: Path
    recordings: tuple[Path, ...]
    holdout: Path
    code: tuple[Path, ...] = ()

    @property
    def all(self) -> tuple[Path, ...]:
        """Every file."""
        return (self.model, *self.code, *self.recordings, self.holdout)


def write(trial: BlindTrial | FieldTrial, folder: str | Path, form: str = "npz") -> TrialPaths:
    """Write MODEL.toml (and the code it names), the recordings and the holdout as tables (``npz`` or ``csv``); return their paths.

    The folder is made; a file that is there already is an error (`BadInput`), so that no trial overwrites another.
    """
    if form not in FORMATS:
        raise BadInput(f"recordings are written as {' or '.join(FORMATS)}, not as '{form}'")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{trace.name}.{form}" for trace in (*trial.recordings, trial.holdout)]
    texts = {folder / name: text for name, text in _texts(trial).items()}
    tables = [folder / name for name in names]
    for path in (*texts, *tables):
        if path.exists():
            raise BadInput(f"{path}: is there already; an empty folder is wanted")
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    for path, trace in zip(tables, (*trial.recordings, trial.holdout), strict=True):
        _write_table(path, trace)
    model, *code = texts
    return TrialPaths(model, tuple(tables[:-1]), tables[-1], tuple(code))


def _texts(trial: BlindTrial | FieldTrial) -> dict[str, str]:
    """Return the texts of MODEL.toml, which comes first, and of its code."""
    if isinstance(trial, FieldTrial):
        return model_files(trial)
    return {"MODEL.toml": nominal_model_text(trial.machine, trial.options.known_controller)}


def _write_table(path: Path, trace: Trace) -> None:
    """Write one column per channel and the time, with the fixed column roles as names."""
    names = ["t", *(channel.name for channel in trace.channels)]
    values = np.column_stack([trace.t, trace.values])
    if path.suffix == ".npz":
        np.savez(path, **dict(zip(names, values.T, strict=True)))
    else:
        np.savetxt(path, values, fmt="%.12g", delimiter=",", header=",".join(names), comments="")


SEAL = "SEAL.json"


def seal(answer: TrialAnswer | FieldAnswer, paths: TrialPaths, vault: str | Path) -> Path:
    """Write the commitment beside the model and the answer into the vault (another folder); return the answer's path.

    Raises `BadInput` when the vault lies inside the trial's folder.
    """
    folder, vault = paths.model.parent.resolve(), Path(vault).resolve()
    if vault == folder or folder in vault.parents:
        raise BadInput(f"{vault}: lies inside the trial's folder {folder}; a folder outside is wanted")
    vault.mkdir(parents=True, exist_ok=True)
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths.all}
    sealed = {"nonce": secrets.token_hex(32), "answer": answer.as_json(), "files": files}
    commitment = {"algorithm": "sha256", "commitment": _digest(sealed)}
    (folder / SEAL).write_text(json.dumps(commitment, indent=1), encoding="utf-8")
    kept = vault / f"{folder.name}.json"
    kept.write_text(json.dumps(sealed, indent=1), encoding="utf-8")
    return kept


def open_seal(folder: str | Path, kept: str | Path) -> TrialAnswer | FieldAnswer:
    """Return the answer of a trial; raises `Refused` when answer, recordings and commitment do not belong together."""
    folder, kept = Path(folder), Path(kept)
    sealed, commitment = _table(kept), _table(folder / SEAL)
    if _digest(sealed) != commitment.get("commitment"):
        raise Refused(f"{kept}: is not the answer that was sealed with {folder}")
    for name, digest in sealed["files"].items():
        path = folder / name
        if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise Refused(f"{path}: is not the file that was sealed")
    return answer_of(sealed["answer"])


def answer_of(table: dict[str, Any]) -> TrialAnswer | FieldAnswer:
    """Return the answer of a trial of either sort from plain values."""
    return FieldAnswer.from_json(table) if "family" in table else TrialAnswer.from_json(table)


def _digest(sealed: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(sealed, sort_keys=True).encode()).hexdigest()


def _table(path: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as a seal: {error}") from None
    return table
