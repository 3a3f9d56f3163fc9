"""A foreign table as a trace: columns by role, a uniform time, numbers bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.files.tables.formats import Columns, read_columns
from afdsvc.files.tables.time_base import time_base
from afdsvc.lti.statespace import Array

TIME = "t"
SAME_STEP = 1e-4  # relative difference of sample times that is taken for rounding


def read_table(
    path: str | Path, mapping: Mapping[str, str] | None = None, dt: float | None = None, allow_nan: bool = False
) -> Trace:
    """Return the table as a trace named after its file.

    Columns are ``t`` [s] and ``u_, y_, alpha_, beta_, ref_, aux_`` names; ``mapping`` renames columns (to "": left
    out). ``dt`` [s] is the sample time of a table without ``t`` and must agree with it otherwise. Raises `BadInput`
    naming file, column and row (counted from 1 below the header) for whatever is wrong; NaN is wrong unless allowed.
    """
    path = Path(path)
    columns = renamed(read_columns(path), mapping or {}, str(path))
    _refuse_unequal(columns, path)
    t0, step = _time(columns.pop(TIME, None), dt, path)
    channels = tuple(_channel(name, path) for name in columns)
    if not channels:
        raise BadInput(f"{path}: has no signal; expected columns such as u_<input> and y_<output>")
    values = np.column_stack(list(columns.values()))
    if not allow_nan:
        _refuse_nan(values, channels, path)
    return Trace(path.name, step, channels, values, t0, {"path": str(path)})


def with_units(trace: Trace, model: Model) -> Trace:
    """Return the trace with the units the model gives its inputs and outputs, where the trace has none."""
    units = {f"u_{v.name}": v.unit for v in model.inputs} | {f"y_{v.name}": v.unit for v in model.outputs}
    units |= {f"ref_{v.name}": v.unit for v in model.outputs}
    channels = tuple(Channel(c.name, c.unit or units.get(c.name, "")) for c in trace.channels)
    return Trace(trace.name, trace.dt, channels, trace.values, trace.t0, trace.notes)


def renamed(columns: Columns, mapping: Mapping[str, str], where: str) -> Columns:
    """Return the columns under their new names; raises `BadInput` for a column that is not there or a name twice."""
    unknown = [name for name in mapping if name not in columns]
    if unknown:
        raise BadInput(f"{where}: no column '{unknown[0]}' to be mapped; it has {', '.join(columns)}")
    found: Columns = {}
    for name, values in columns.items():
        new = mapping.get(name, name)
        if new in found:
            raise BadInput(f"{where}: two columns would be called '{new}'; expected one")
        if new:
            found[new] = values
    return found


def _channel(name: str, path: Path) -> Channel:
    try:
        return Channel(name)
    except BadInput as error:
        raise BadInput(f"{path}: {error}, or a mapping of this column") from None


def _refuse_unequal(columns: Columns, path: Path) -> None:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"'{name}' {n}" for name, n in lengths.items())
        raise BadInput(f"{path}: columns of different lengths ({listed}); expected equal lengths")
    if not any(lengths.values()):
        raise BadInput(f"{path}: has no rows; expected samples")


def _time(t: Array | None, dt: float | None, path: Path) -> tuple[float, float]:
    if t is None:
        if dt is None or not dt > 0:
            raise BadInput(f"{path}: has no column 't', and no sample time is known; expected one of the two")
        return 0.0, dt
    t0, step = time_base(t, f"{path}: column 't'")
    if not dt:
        return t0, step
    if abs(step - dt) > SAME_STEP * dt:
        raise BadInput(f"{path}: column 't' has a sample time of {step:.6g} s; expected {dt:.6g} s")
    return t0, dt


def _refuse_nan(values: Array, channels: tuple[Channel, ...], path: Path) -> None:
    rows, columns = np.nonzero(~np.isfinite(values))
    if rows.size:
        found = f"column '{channels[columns[0]].name}', row {rows[0] + 1} holds {values[rows[0], columns[0]]}"
        raise BadInput(f"{path}: {found} ({rows.size} such cells in all); expected finite numbers")
