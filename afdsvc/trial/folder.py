"""A trial on disk: the model, the recordings, and nothing else that would tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.trial.field.generate import FieldTrial
from afdsvc.trial.generate import BlindTrial
from afdsvc.trial.model_text import model_files, nominal_model_text

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
