"""`afdsvc init`: a first MODEL.toml and a mapping file from a table's own columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.dataset.units import is_velocity
from afdsvc.errors import BadInput
from afdsvc.files.model.schema import Inline, toml_text
from afdsvc.files.open import TABLES
from afdsvc.files.tables.foreign import read_foreign_columns
from afdsvc.files.tables.formats import read_columns
from afdsvc.files.tables.historian import is_export, read_export
from afdsvc.files.tables.mapping import DataMapping, Heading, heading, role_of_unit
from afdsvc.files.tables.time_base import is_stamped, own_time
from afdsvc.files.unfinished import writing
from afdsvc.identify.first_model import Polynomials, first_model

MODEL, MAPPING = "MODEL.toml", "mapping.toml"
ESTIMATED = "# Estimated from {file}: a lag for each speed, a resonance for any other output. Put what you know of the machine in its place.\n"
RELATIVE = 0.3  # how well the estimate is known where physics is missing from it
NEXT = """afdsvc check {model} {recording} --mapping {mapping}
afdsvc explain {model} {recording} --mapping {mapping}"""


def init_files(recording: Path, out: Path | None = None, inputs: Sequence[str] = (), outputs: Sequence[str] = (), overwrite: bool = False) -> dict[str, Any]:
    """Write MODEL.toml and mapping.toml for a table and return what was found, column by column.

    ``inputs`` and ``outputs`` are columns whose role their names do not say. Raises `BadInput` where there is no input or no output, and
    where a file is there already.
    """
    if recording.suffix.lower() not in TABLES:
        raise BadInput(f"{recording}: is no table; expected one that ends in {', '.join(TABLES)}")
    folder = out or recording.parent
    model, mapping = folder / MODEL, folder / MAPPING
    there = next((f for f in (model, mapping) if f.exists() and not overwrite), None)
    if there is not None:
        raise BadInput(f"{there}: is there already; expected another folder (--out DIR), or --overwrite")
    columns = {n: v for n, (_, v) in read_export(recording)[0].items()} if is_export(recording) else read_columns(recording)
    time = own_time(columns) or next((n for n in columns if heading(n).role == "t"), "")
    found = _headings(recording, [n for n in columns if n != time and not is_stamped(columns[n])], inputs, outputs)
    text = _mapping(found, time, bool(time) and is_stamped(columns[time]))
    (trace, *_) = read_foreign_columns(recording, DataMapping.model_validate(text), None)
    ins, outs = ([h for h in found if h.role == role] for role in ("u", "y"))
    u = np.column_stack([trace.column(f"u_{h.label}") for h in ins])
    fits = [first_model(u, trace.column(f"y_{h.label}"), trace.dt, is_velocity(h.unit)) for h in outs]
    folder.mkdir(parents=True, exist_ok=True)
    with writing(model, mapping):
        mapping.write_text(f"# Which column of {recording.name} is which signal, and in what unit.\n{_toml(text)}", encoding="utf-8")
        model.write_text(_model(recording, ins, outs, fits), encoding="utf-8")
    return {
        "model": str(model), "mapping": str(mapping), "sample_time": trace.dt, "time": time,
        "columns": [{"column": h.name, "signal": f"{h.role}_{h.label}", "unit": h.unit} for h in found],
        "fits": {h.label: {"r2": f.r2, "num": f.num, "den": f.den} for h, f in zip(outs, fits, strict=True)},
        "next": NEXT.format(model=model, recording=recording, mapping=mapping).splitlines(),
    }  # fmt: skip


def _headings(recording: Path, names: Sequence[str], inputs: Sequence[str], outputs: Sequence[str]) -> list[Heading]:
    for name in (*inputs, *outputs):
        if name not in names:
            raise BadInput(f"{recording}: no column '{name}'; it has {', '.join(names)}")
    found = [h for h in (heading(n, inputs, outputs) for n in names) if h.role != "t"]
    for role, option, examples in (("u", "--input", "voltage_V or torque_Nm"), ("y", "--output", "speed_rpm or position_mm")):
        if not any(h.role == role for h in found):  # where no name says it, units do
            found = [replace(h, role=role) if h.role == "aux" and not h.name.startswith("aux_") and role_of_unit(h.unit) == role else h for h in found]
        if not any(h.role == role for h in found):
            raise BadInput(f"{recording}: no column name says that it is an {option[2:]}, as {examples} does; expected {option} COLUMN, one of {', '.join(names)}")
    labels = [f"{h.role}_{h.label}" for h in found]
    return [replace(h, label=f"{h.label}_{k}") if labels.count(f"{h.role}_{h.label}") > 1 else h for k, h in enumerate(found, 1)]


def _mapping(found: Sequence[Heading], time: str, stamped: bool) -> dict[str, Any]:
    unit = heading(time).unit if time else ""
    clock = {"from": time} | ({} if stamped or not unit else {"unit": unit}) if time else {}
    signals = {f"{h.role}_{h.label}": {"from": h.name} | ({"unit": h.unit} if h.unit else {}) for h in found}
    return ({"time": clock} if clock else {}) | {"signals": signals}


def _toml(text: dict[str, Any]) -> str:
    return toml_text({k: {n: Inline(v) if isinstance(v, dict) else v for n, v in section.items()} for k, section in text.items()}).lstrip()


def _model(recording: Path, ins: Sequence[Heading], outs: Sequence[Heading], fits: Sequence[Polynomials]) -> str:
    single = len(ins) == len(outs) == 1
    table = {
        "name": recording.stem, "time": "continuous",
        "inputs": [Inline(name=h.label, unit=h.unit) for h in ins], "outputs": [Inline(name=h.label, unit=h.unit) for h in outs],
        "num": list(fits[0].num) if single else [[[v] for v in f.num] for f in fits],
        "den": list(fits[0].den) if single else [[list(f.den)] * len(ins) for f in fits],
        "uncertainty": {"relative": RELATIVE},
    }  # fmt: skip
    return ESTIMATED.format(file=recording.name) + toml_text(table)
