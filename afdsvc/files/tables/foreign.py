"""Foreign recordings as traces, by a mapping; every change to the data is kept as a note."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.units import unknown_unit
from afdsvc.errors import BadInput
from afdsvc.files.recording.reader import Recording
from afdsvc.files.tables.alignment import Group, aligned, held_pieces
from afdsvc.files.tables.foreign_mcap import maps, places_of, read_topics, shown
from afdsvc.files.tables.formats import opened, read_columns
from afdsvc.files.tables.historian import is_export, read_export
from afdsvc.files.tables.mapping import OWN_TIMES, DataMapping, Source, Time, converted, product, same_unit
from afdsvc.files.tables.rosbag import BAGS, read_bag
from afdsvc.files.tables.tables import PREPARED
from afdsvc.files.tables.time_base import TIME, UNITS, is_stamped, own_time, seconds
from afdsvc.files.validation import BOUNDS, file_size, in_time, refuse_more
from afdsvc.lti.statespace import Array

ULOG = ".ulg"  # of PX4: topics at rates of their own, so a mapping is always needed
FIELDS = 65_536  # of all topics of a ULog together
_AUX_UNITS = {"aux_speed": "rad/s", "aux_angle": "rad"}


def topic_places(path: Path) -> list[str]:
    """Return what a mapping may name in a file whose topics have times of their own (a bag, a ULog); nothing for a table."""
    kind = path.suffix.lower()
    return _ulog_places(path) if kind == ULOG else places_of(path, read_bag(path, lambda topic: True)) if kind in BAGS else []


def needs_mapping(path: Path, why: str, places: Sequence[str]) -> BadInput:
    """Return the refusal of a file of topics without a mapping."""
    how = "expected a mapping file (--mapping FILE.toml) with [signals] such as u_force = 'TOPIC.FIELD', as `afdsvc init` writes it"
    return BadInput(f"{path}: {why}; {how}; it has {shown(places)}")


def read_foreign_columns(path: Path, mapping: DataMapping, model: Model | None = None) -> list[Trace]:
    """Return the mapped columns of a table as traces, see `read_foreign_topics`."""
    kind = path.suffix.lower()
    read = _ulog if kind == ULOG else _bag if kind in BAGS else _export if is_export(path) else _table
    found = read(path, _places(mapping), mapping.time)
    return _mapped(path, *found, mapping, model)


def read_foreign_topics(recording: Recording, mapping: DataMapping, model: Model | None = None) -> list[Trace]:
    """Return the mapped topics of an MCAP file, one trace per stretch without a gap.

    Units become the model's where it has any, the sample time the mapping's, else that of a discrete model, else the slowest
    signal's. The note `PREPARED` of every trace says all that was done. Raises `BadInput` naming file, signal and place.
    """
    found = read_topics(recording.path, recording.items(), _places(mapping), mapping.time)
    return _mapped(recording.path, *found, mapping, model)


def _places(mapping: DataMapping) -> dict[str, str]:
    return {signal: source.place for signal, source in mapping.signals.items()}


def _mapped(path: Path, groups: Sequence[Group], done: Sequence[str], mapping: DataMapping, model: Model | None) -> list[Trace]:
    remarks = list(done)
    dt = mapping.resample.dt or (model.plant.dt if model and model.plant and model.plant.discrete else None)
    units = _model_units(model)
    named, channels = [], []
    for group in groups:
        columns = {}
        for signal, values in group.columns.items():
            if wrong := unknown_unit(units.get(signal, "")):
                raise BadInput(f"the model's {signal}: {wrong}")
            columns[signal], channel, sentence = _converted(signal, values, mapping.signals[signal], units.get(signal, ""), path)
            channels.append(channel)
            remarks.append(sentence)
        named.append(Group(group.name, group.t, columns))
    if mapping.resample.hold and dt:
        pieces, aligning = held_pieces(named, str(path), dt)
    else:
        pieces, aligning = aligned(named, str(path), dt, mapping.resample.gap, mapping.time.regular)
    notes = {"path": str(path), PREPARED: "\n".join([*remarks, *aligning])}
    order = _order(channels)
    sorted_channels = tuple(channels[i] for i in order)
    return [Trace(path.name, p.dt, sorted_channels, np.ascontiguousarray(p.values[:, order]), p.start, notes) for p in pieces]


def _model_units(model: Model | None) -> dict[str, str]:
    """Return the unit of every signal a model speaks of."""
    if model is None:
        return dict(_AUX_UNITS)
    found = {f"{role}_{v.name}": v.unit for role in ("u", "alpha") for v in model.inputs}
    return _AUX_UNITS | found | {f"{role}_{v.name}": v.unit for role in ("y", "beta", "ref") for v in model.outputs}


def prepared(traces: Sequence[Trace]) -> list[str]:
    """Return what was done to the data of traces, every sentence once, behind the names of its files."""
    files: dict[str, dict[str, None]] = {}
    for trace in traces:
        for sentence in trace.notes.get(PREPARED, "").splitlines():
            files.setdefault(sentence, {})[Path(trace.notes.get("path", trace.name)).name] = None
    return [f"{', '.join(names)}: {sentence}" for sentence, names in files.items()]


def in_model_units(trace: Trace, model: Model) -> Trace:
    """Return the trace with the model's units: given where it has none, converted, with a note, where it has others."""
    units, remarks = _model_units(model), []
    values, channels = trace.values, []
    for i, channel in enumerate(trace.channels):
        expected = units.get(channel.name, "")
        if channel.unit and expected and channel.unit != expected:
            where = f"{trace.name}: {channel.name}"
            if not same_unit(channel.unit, expected, where):
                values = values.copy() if values is trace.values else values
                values[:, i] = converted(values[:, i], channel.unit, expected, where)
                remarks.append(f"{channel.name} is recorded in {channel.unit} and converted to {expected}")
            channel = Channel(channel.name, expected)
        channels.append(Channel(channel.name, channel.unit or expected))
    before = trace.notes.get(PREPARED, "")
    notes = {**trace.notes, PREPARED: "\n".join([*before.splitlines(), *remarks])} if remarks else trace.notes
    return Trace(trace.name, trace.dt, tuple(channels), values, trace.t0, notes)


def _converted(signal: str, stored: Array, source: Source, unit: str, path: Path) -> tuple[Array, Channel, str]:
    """Return a signal in the requested unit, its channel, and the sentence on what was done to it."""
    where, expected = f"{path}: {signal} from '{source.place}'", source.to or unit
    values = stored if source.offset == 0 else stored + source.offset
    said = f"{signal} is {source.place}" + (f" [{source.unit}]" if source.unit else "")
    if source.offset:
        said += f" plus {source.offset:g}" + (f" {source.unit}" if source.unit else "")
    given = source.unit
    if source.factor != 1 or source.factor_unit:
        values = values * source.factor
        said += f", times {source.factor:g}" + (f" {source.factor_unit}" if source.factor_unit else "")
        given = product(source.unit, source.factor_unit, where) if source.factor_unit else source.unit
    if not given:
        return values, Channel(signal, expected), f"{said}, taken to be in {expected}" if expected else f"{said}, its unit unknown"
    if not expected or same_unit(given, expected, where):
        return values, Channel(signal, expected or given), said if not expected or given == source.unit else f"{said}, in {expected}"
    return converted(values, given, expected, where), Channel(signal, expected), f"{said}, converted to {expected}"


def _table(path: Path, places: Mapping[str, str], time: Time) -> tuple[list[Group], list[str]]:
    """Return the mapped columns of a table as one group, and what there is to say of its time and its other columns."""
    columns = read_columns(path)
    absent = next((place for place in places.values() if place not in columns), None)
    if absent is not None:
        raise BadInput(f"{path}: no column '{absent}' to be mapped; it has {', '.join(columns)}")
    stamped = next((place for place in places.values() if is_stamped(columns[place])), None)
    if stamped is not None:
        raise BadInput(f"{path}: column '{stamped}' holds time stamps; expected numbers in a signal")
    t, sentence, used = _table_time(columns, time, path)
    remarks = [sentence]
    left = [name for name in columns if name not in {*places.values(), used}]
    if left:
        remarks.append(f"not mapped and left out: {', '.join(left)}")
    chosen = {signal: columns[place] for signal, place in places.items()}
    lengths = {len(v) for v in (t if t is not None else next(iter(chosen.values())), *chosen.values())}
    if len(lengths) > 1:
        raise BadInput(f"{path}: columns of {', '.join(map(str, sorted(lengths)))} rows; expected equal lengths")
    if t is None:
        t = np.asarray((time.step or 0.0) * np.arange(max(lengths)), dtype=np.float64)
    slow = {signal: Group(places[signal], t[full], {signal: values[full]}) for signal, values in chosen.items() if _slower(full := np.isfinite(values))}
    return [*([Group("the table", t, rest)] if (rest := {s: v for s, v in chosen.items() if s not in slow}) else []), *slow.values()], remarks


def _slower(full: Array) -> bool:
    """Whether a column was sampled at a rate below the rows': most of its cells are followed by empty ones."""
    rows = np.flatnonzero(full)
    return len(rows) > 1 and float(np.median(np.diff(rows))) > 1


def _export(path: Path, places: Mapping[str, str], time: Time) -> tuple[list[Group], list[str]]:
    """Return the mapped tags of a historian's export, a group for each."""
    tags, remarks = read_export(path)
    absent = next((place for place in places.values() if place not in tags), None)
    if absent is not None:
        raise BadInput(f"{path}: no tag '{absent}' to be mapped; it has {', '.join(tags)}")
    left = [name for name in tags if name not in places.values()]
    return [Group(place, tags[place][0], {signal: tags[place][1]}) for signal, place in places.items()], [*remarks, *([f"not mapped and left out: {', '.join(left)}"] if left else [])]


def _ulog_topics(path: Path) -> tuple[dict[str, dict[str, Array]], list[str]]:
    """Return the fields of every topic (``topic[1]`` is its second instance) of a PX4 log, and sentences on damage."""
    try:
        from pyulog import ULog
    except ImportError:
        raise BadInput(f"{path}: ULog needs the extra 'ulog': install afdsvc[ulog]") from None
    size, damage, fields = file_size(path, BOUNDS.table), io.StringIO(), 0

    class Bounded(ULog):  # type: ignore[misc]
        class _MessageAddLogged(ULog._MessageAddLogged):  # type: ignore[misc] # noqa: SLF001
            def _parse_nested_type(self, prefix: str, name: str, formats: Any) -> None:
                """Arrays inside arrays grow from a few bytes to any number of fields."""
                nonlocal fields
                fields += sum(max(size, 1) for _, size, _ in formats[name].fields)
                refuse_more(path, fields, FIELDS, "fields of topics")
                super()._parse_nested_type(prefix, name, formats)

    try:
        with opened(path) as file, redirect_stdout(damage):  # where pyulog says so
            topics = {f"{d.name}[{d.multi_id}]" if d.multi_id else d.name: d.data for d in in_time(lambda: Bounded(file).data_list, path, size)}
    except BadInput:
        raise
    except Exception as error:  # a log that is none fails in many ways
        raise BadInput(f"{path}: not a readable ULog file: {type(error).__name__}: {error}") from None
    return topics, [f"not all could be read: {damage.getvalue().splitlines()[0]}"] if damage.getvalue() else []


def _ulog_places(path: Path) -> list[str]:
    return sorted(f"{topic}.{name}" for topic, data in _ulog_topics(path)[0].items() for name in data if name != "timestamp")


def _ulog(path: Path, places: Mapping[str, str], time: Time) -> tuple[list[Group], list[str]]:
    """Return the mapped fields of a PX4 log, a group for each topic."""
    topics, damage = _ulog_topics(path)
    groups: dict[str, dict[str, Array]] = {}
    for signal, place in places.items():
        topic, _, name = place.partition(".")
        if name not in topics.get(topic, {}):
            listed = ", ".join(f"{t} ({', '.join(k for k in data if k != 'timestamp')})" for t, data in sorted(topics.items()))
            raise BadInput(f"{path}: no '{place}', which is to be {signal}; expected TOPIC.FIELD, and it has {listed or 'no topics'}")
        if not len(topics[topic].get("timestamp", ())):
            raise BadInput(f"{path}: topic '{topic}' holds no 'timestamp'; expected one for every sample")
        groups.setdefault(topic, {})[signal] = np.asarray(topics[topic][name], dtype=np.float64)
    first = min(int(topics[t]["timestamp"][0]) for t in groups)
    made = [Group(t, np.asarray((topics[t]["timestamp"].astype(np.int64) - first) * 1e-6, dtype=np.float64), columns) for t, columns in groups.items()]
    return made, ["the time of a sample is the time stamp of its topic", *damage]


def _bag(path: Path, places: Mapping[str, str], time: Time) -> tuple[list[Group], list[str]]:
    """Return the mapped topics of a bag of ROS, a group for each."""
    return read_topics(path, read_bag(path, lambda topic: maps(places, topic)), places, time)


def _table_time(columns: Mapping[str, Array], time: Time, path: Path) -> tuple[Array | None, str, str]:
    """Return the times [s] of a table (None: none are stored), how they are known, and the column they come from."""
    column = (own_time(columns) or TIME) if time.place in OWN_TIMES else time.place
    if column in columns and (is_stamped(columns[column]) or (time.place in OWN_TIMES and UNITS.get(column, 1.0) != 1.0)):
        return *seconds(columns[column], column), column
    if column in columns:
        t = converted(columns[column], time.unit, "s", f"{path}: time '{column}'")
        return t, f"the time of a sample is column {column} [{time.unit}]", column
    if time.place not in OWN_TIMES:
        raise BadInput(f"{path}: no column '{column}' for the time; it has {', '.join(columns)}")
    if time.step is None:
        raise BadInput(f"{path}: has no column '{TIME}'; expected key 'time.from', a column, or 'time.step' [s] in the mapping")
    return None, f"the table has no time; by the mapping, samples are {time.step:g} s apart", ""


def _order(channels: Sequence[Channel]) -> list[int]:
    """Return the order of roles that recordings have: inputs, outputs, then what else there is."""
    rank = {"u": 0, "y": 1, "alpha": 2, "beta": 3, "ref": 4, "aux": 5}
    return sorted(range(len(channels)), key=lambda i: rank[channels[i].role])
