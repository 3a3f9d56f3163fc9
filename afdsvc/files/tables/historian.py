"""Exports of plant historians: one value a row, with the name of its tag and its time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from afdsvc.errors import BadInput
from afdsvc.files.tables.formats import TAGS, VALUES, head, holds_tags, is_stamp, opened, stamps
from afdsvc.files.validation import BOUNDS, file_size, in_time
from afdsvc.lti.statespace import Array

Tags = dict[str, tuple[Array, Array]]


def is_export(path: Path) -> bool:
    """Return whether a CSV file names a column of tags and one of values."""
    if path.suffix.lower() != ".csv":
        return False
    opened(path).close()
    return holds_tags(head(path)[0])


def read_export(path: Path) -> tuple[Tags, list[str]]:
    """Return times [s, from the first of all] and values of every tag, each of shape ``(n,)``, and what there is to say of them.

    Raises `BadInput` where no column holds ISO 8601 times, or one of them is none.
    """
    size = file_size(path, BOUNDS.table)
    return in_time(lambda: _read_export(path), path, size)


def _read_export(path: Path) -> tuple[Tags, list[str]]:
    header, _, delimiter = head(path)
    tag, value = (next(n for n in header if n.lower() in known) for known in (TAGS, VALUES))
    try:
        table = pyarrow.csv.read_csv(
            path,
            read_options=pyarrow.csv.ReadOptions(column_names=header, skip_rows=1),
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
            convert_options=pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(header, pa.string())),
        )
    except pa.ArrowInvalid as error:
        raise BadInput(f"{path}: not a readable table: {str(error).splitlines()[0]}") from None
    time = next((n for n in header if len(table) and is_stamp(table[n][0].as_py())), None)
    if time is None:
        raise BadInput(f"{path}: no column of its first row holds a time; expected one such as 2026-11-21T10:00:00.125+01:00")
    values = np.array([_number(text) for text in table[value].to_pylist()])
    good = np.isfinite(values)
    at = stamps(path, time, table[time]).astype(np.int64)
    names, which = np.unique(np.array(table[tag].to_pylist(), dtype=str), return_inverse=True)
    found = {}
    for k, name in enumerate(names.tolist()):
        own = np.flatnonzero(good & (which == k))
        if own.size:
            found[name] = ((at[own] - at.min()) * 1e-9, values[own])
    left = int(np.sum(~good))
    return found, [f"the time of a value is column {time}, its tag column {tag}", *([f"{left} of {len(good)} values are not numbers and are left out"] if left else [])]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
