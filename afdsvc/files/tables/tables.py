"""A foreign table as a trace (columns by role, a uniform time, numbers bit for bit), and traces as a recording with the model beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Channel, Trace
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import model_text
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.tables.formats import Columns, read_columns
from afdsvc.files.tables.mapping import DataMapping
from afdsvc.files.tables.time_base import TIME, UNITS, is_stamped, own_step, own_time, seconds, time_base
from afdsvc.files.unfinished import writing
from afdsvc.lti.statespace import Array
from afdsvc.wire.codec import encode_block
from afdsvc.wire.keys import checked_machine

PREPARED = "prepared"  # the note of a trace that holds the sentences on what was done to its samples, one a line
SAME_STEP = 1e-4  # relative difference of sample times that is taken for rounding


def read_table(
    path: str | Path, mapping: Mapping[str, str] | None = None, dt: float | None = None, allow_nan: bool = False, default_dt: float | None = None,
    model: Model | None = None,
) -> Trace:
    """Return the table as a trace named after its file.

    Columns are the time (``t`` [s], ``t_ms``, ``t_us``, ``t_ns``, or a column of time stamps) and ``u_, y_, alpha_, beta_, ref_, aux_`` names; ``mapping`` renames columns (to "": left
    out); those that bear a name of the ``model`` need no role (`own_names`). ``dt`` [s] is the sample time of a table without time and must agree with it otherwise, ``default_dt`` need not. Raises `BadInput`
    naming file, column and row (counted from 1 below the header) for whatever is wrong; NaN is wrong unless allowed.
    """
    path = Path(path)
    columns = _renamed(read_columns(path), mapping or {}, str(path))
    own = own_names(columns, model) if model else {}
    return table_trace(_renamed(columns, own, str(path)), path, dt, allow_nan, default_dt)


def own_mapping(path: Path, pairs: Mapping[str, str], model: Model | None = None) -> DataMapping:
    """Return the mapping by which a table is read as `read_table` does, gaps apart; raises `BadInput` for a column without a role."""
    columns = read_columns(path)
    names = {column: pairs.get(column, column) for column in columns if column != own_step(columns)[0]}
    own = own_names(names.values(), model) if model else {}
    time = own_time({new: columns[old] for old, new in names.items()})
    unit = time.removeprefix("t_") if time in UNITS and time != TIME else "s"
    clock = {"from": next(old for old, new in names.items() if new == time), "unit": unit}
    signals = {old: _channel(own.get(new, new), path).name for old, new in names.items() if new and new != time}
    return DataMapping.model_validate({"time": clock}).extended(signals)


def table_trace(columns: Columns, path: Path, dt: float | None = None, allow_nan: bool = False, default_dt: float | None = None) -> Trace:
    """Return columns by name as a trace named after ``path``, as `read_table` does."""
    columns = dict(columns)
    name, stated = own_step(columns)
    if stated is not None:
        del columns[name]
        default_dt = stated
    _refuse_unequal(columns, path)
    counted = next((name for name in columns if name.isdigit()), "")
    if counted:
        raise BadInput(
            f"{path}: the first row holds numbers, so columns are counted: {', '.join(columns)}; say what they are with --map 1=t --map 2=u_force "
            f"--map 3=y_position (rename=), or leave one out with --map {counted}="
        )
    time = own_time(columns)
    t, said = seconds(columns.pop(time), time) if time else (None, "")
    t0, step = _time(t, time or TIME, dt, default_dt, path)
    stamped = next((name for name, column in columns.items() if is_stamped(column)), None)
    if stamped is not None:
        raise BadInput(f"{path}: column '{stamped}' holds time stamps beside the time '{time or TIME}'; leave it out with --map {stamped}= (rename=)")
    channels = tuple(_channel(name, path) for name in columns)
    if not channels:
        raise BadInput(f"{path}: has no signal; expected columns such as u_<input> and y_<output>")
    values = np.column_stack(list(columns.values()))
    if not allow_nan:
        _refuse_nan(values, channels, path)
    return Trace(path.name, step, channels, values, t0, {"path": str(path), **({PREPARED: said} if said else {})})


def with_units(trace: Trace, model: Model) -> Trace:
    """Return the trace with the units the model gives its inputs and outputs, where the trace has none."""
    units = {f"u_{v.name}": v.unit for v in model.inputs} | {f"y_{v.name}": v.unit for v in model.outputs}
    units |= {f"ref_{v.name}": v.unit for v in model.outputs}
    channels = tuple(Channel(c.name, c.unit or units.get(c.name, "")) for c in trace.channels)
    return Trace(trace.name, trace.dt, channels, trace.values, trace.t0, trace.notes)


def _renamed(columns: Columns, mapping: Mapping[str, str], where: str) -> Columns:
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


def own_names(columns: Iterable[str], model: Model) -> dict[str, str]:
    """Return which columns bear the name of one of the model's inputs and outputs, with the role they have there.

    ``u`` and ``y``, or ``u_1``, ``u_2``, ... (the columns of a matrix), are the inputs and outputs in the model's order.

    >>> motor = Model.from_system(([3.0], [0.2, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    >>> own_names(["t", "voltage", "speed"], motor), own_names(["t", "u", "y_1"], motor)
    ({'voltage': 'u_voltage', 'speed': 'y_speed'}, {'u': 'u_voltage', 'y_1': 'y_speed'})
    """
    there, found = set(columns), dict[str, str]()
    for role, side in (("u", model.inputs), ("y", model.outputs)):
        plain = [v.name for v in side]
        others = {v.name for v in (*model.inputs, *model.outputs)} - set(plain)
        found |= {n: f"{role}_{n}" for n in plain if n in there and n not in others and f"{role}_{n}" not in there}
        counted = [role] if len(side) == 1 and role in there else [f"{role}_{k}" for k in range(1, len(side) + 1)]
        if there.issuperset(counted) and not set(counted) & {f"{role}_{n}" for n in plain}:
            found |= {c: f"{role}_{n}" for c, n in zip(counted, plain, strict=True)}
    return found


def _channel(name: str, path: Path) -> Channel:
    try:
        return Channel(name)
    except BadInput as error:
        cure = "; rename the column, name it with --map COLUMN=u_name (rename=), or let afdsvc init write a mapping file"
        raise BadInput(f"{path}: {error}{cure}") from None


def _refuse_unequal(columns: Columns, path: Path) -> None:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"'{name}' {n}" for name, n in lengths.items())
        raise BadInput(f"{path}: columns of different lengths ({listed}); expected equal lengths")
    if not any(lengths.values()):
        raise BadInput(f"{path}: has no rows; expected samples")


def _time(t: Array | None, column: str, dt: float | None, default: float | None, path: Path) -> tuple[float, float]:
    if t is None:
        dt = dt or default
        if dt is None or not dt > 0:
            raise BadInput(f"{path}: has no column 't', and no sample time is known; expected t in seconds, t_ms, or a column of ISO 8601 time stamps; name it with --map COLUMN=t (rename=), or let afdsvc init write a mapping file")
        return 0.0, dt
    t0, step = time_base(t, f"{path}: column '{column}'")
    if not dt:
        return t0, step
    if abs(step - dt) > SAME_STEP * dt:
        raise BadInput(f"{path}: column '{column}' has a sample time of {step:.6g} s; expected {dt:.6g} s")
    return t0, dt


def _refuse_nan(values: Array, channels: tuple[Channel, ...], path: Path) -> None:
    rows, columns = np.nonzero(~np.isfinite(values))
    if rows.size:
        found = f"column '{channels[columns[0]].name}', row {rows[0] + 1} holds {values[rows[0], columns[0]]}"
        raise BadInput(f"{path}: {found} ({rows.size} such cells in all); expected finite numbers")


BLOCK_SECONDS = 0.05


def import_table(
    trace: Trace, path: str | Path, model: Model | None = None, machine: str = "table", start_ns: int = 0,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write a trace as a recording of one machine and return its path; raises `BadInput` when it cannot be written.

    ``start_ns`` is the Unix time of sample 0 (a table knows none: 1970 then). Units come from the model.
    """
    return import_traces([trace], path, model, machine, start_ns, overwrite)


def import_traces(
    traces: Sequence[Trace], path: str | Path, model: Model | None = None, machine: str = "table", start_ns: int = 0,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write the stretches of one machine between gaps as `import_table` does one; the gaps stay.

    Their times count from the first one's, in samples; what was done to the data is kept with the facts.
    """
    checked_machine(machine)
    traces = [with_units(t, model) if model else t for t in traces]
    first, samples = traces[0], sum(len(t) for t in traces)
    facts = {"source": first.name, "t0": repr(first.t0), "dt": repr(first.dt), "samples": str(samples)}
    if first.notes.get("prepared"):
        facts["prepared"] = first.notes["prepared"]
    models = {machine: model.raw or model_text(model)} if model else {}
    # One file, whatever its size: a table is one thing.
    settings = RecordingSettings(Path(path), max_bytes=1 << 62, max_seconds=float("inf"), overwrite=overwrite)
    with writing(Path(path)):
        recorder = Recorder(settings, Header(models=models))
        recorder.facts("import", facts)
        for block in _blocks(traces, machine, start_ns):
            recorder.block(encode_block(block), block)
        recorder.close()
    return recorder.path


def _blocks(traces: Sequence[Trace], machine: str, start_ns: int) -> Iterator[Block]:
    dt = traces[0].dt
    length, seq = max(1, round(BLOCK_SECONDS / dt)), 0
    for trace in traces:
        first = round((trace.t0 - traces[0].t0) / dt)
        for k in range(0, len(trace), length):
            t_ns = start_ns + round((first + k) * dt * 1e9)
            yield Block(machine, "table", seq, first + k, dt, t_ns, trace.channels, trace.values[k : k + length])
            seq += 1
