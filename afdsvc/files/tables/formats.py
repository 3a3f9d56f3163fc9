"""Foreign tables as columns of numbers or time stamps: CSV, Parquet, MAT (5 and 7.3), NPZ, TDMS."""

from __future__ import annotations

import csv
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from afdsvc.errors import BadInput
from afdsvc.files.tables.mat5 import read_mat5
from afdsvc.files.validation import BOUNDS, file_size, in_time, refuse_more, table_bytes
from afdsvc.lti.statespace import Array

log = logging.getLogger(__name__)
Columns = dict[str, Array]
TAGS, VALUES = ("tag", "tagname", "tag_name", "point", "variable"), ("value", "val")  # columns of a historian's export
_LFS = b"version https://git-lfs"


def read_columns(path: Path) -> Columns:
    """Return columns by name, shape ``(n,)``, empty cells as NaN; raises `BadInput` naming file, column and row.

    A column of time stamps (ISO 8601 with or without zone in CSV, dates in Parquet) is ``datetime64[ns]``, in UTC where zones are given.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise BadInput(f"{path}: tables end in {', '.join(_READERS)}; this one ends in '{path.suffix}'")
    opened(path).close()
    size = file_size(path, BOUNDS.table)
    try:
        return in_time(lambda: reader(path), path, size)
    except BadInput:
        raise
    except Exception as error:  # five libraries, each with errors of its own for files that are not what they claim
        why = "it holds Python objects; expected arrays of numbers" if "allow_pickle" in str(error) else _first_line(error)
        raise BadInput(f"{path}: not a readable {path.suffix} file: {why}") from None


def stated_units(path: Path) -> dict[str, str]:
    """Return the units that a file states beside its columns, by column: properties of TDMS channels, metadata of Parquet fields; of other files none."""
    if path.suffix.lower() == ".tdms":
        with _tdms_file(path) as file:
            return {n: str(c.properties["unit_string"]) for n, c in _channels(file).items() if c.properties.get("unit_string")}
    if path.suffix.lower() == ".parquet":
        stated = {f.name: f.metadata or {} for f in pyarrow.parquet.read_schema(path)}
        found = {n: facts.get(b"unit", facts.get(b"units", b"")) for n, facts in stated.items()}
        return {n: unit.decode(errors="replace") for n, unit in found.items() if unit}
    return {}


def opened(path: Path) -> BinaryIO:
    """Return the file, opened; raises `BadInput` when it cannot be, or when Git LFS has left its pointer in the file's place."""
    if path.is_dir():
        inside = sorted(p.name for p in path.iterdir() if p.is_file())[:4]
        raise BadInput(f"{path}: is a folder; expected a file, such as one in it ({', '.join(inside) or 'it is empty'})")
    try:
        file = path.open("rb")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    if file.read(len(_LFS)) == _LFS:
        file.close()
        raise BadInput(f"{path}: is a Git LFS pointer, not the file itself; run 'git lfs pull' to fetch it")
    file.seek(0)
    return file


def head(path: Path) -> tuple[list[str], str, str]:
    """Return the cells of the first line of a CSV file, its second line, and what separates cells."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            first, second = file.readline(BOUNDS.line + 1), file.readline(BOUNDS.line + 1)
        except UnicodeDecodeError:
            raise BadInput(f"{path}: is not a readable .csv; expected text in UTF-8") from None
    refuse_more(path, len(first), BOUNDS.line, "characters in its first line")
    delimiter = next((d for d in ";\t," if d in first), ",")
    return [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])], second, delimiter


def holds_tags(header: Iterable[str]) -> bool:
    """Return whether a table with this header is an export of a historian: one value a row, with its tag."""
    names = {name.lower() for name in header}
    return bool(names & set(TAGS)) and bool(names & set(VALUES))


def _csv(path: Path) -> Columns:
    header, second, delimiter = head(path)
    if holds_tags(header):
        raise BadInput(f"{path}: holds one value a row, each with its tag; expected a mapping file (--mapping FILE.toml), which 'afdsvc init' writes")
    point = "," if delimiter != "," and "," in second else "."
    named = not (header and all(is_stamp(name) or _is_number(name.replace(point, ".")) for name in header))
    if not named:  # no header: columns are counted
        header = [str(k) for k in range(1, len(header) + 1)]
    _refuse_names(path, header)
    timed = [name for name, cell in zip(header, next(csv.reader([second], delimiter=delimiter), []), strict=False) if is_stamp(cell)]
    try:
        table = pyarrow.csv.read_csv(
            path,
            # The header was read above, in the one way that tolerates spaces around names.
            read_options=pyarrow.csv.ReadOptions(column_names=header, skip_rows=int(named)),
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(header, pa.float64()) | dict.fromkeys(timed, pa.string()), decimal_point=point
            ),
        )
    except pa.ArrowInvalid:
        _name_bad_cell(path, header, timed, delimiter, point, named)
        raise
    return {name: stamps(path, name, table[name]) if name in timed else _numbers(path, name, table[name].to_numpy()) for name in header}


_STAMP = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s*(Z|[+-]\d\d:?\d\d)?\s*")


def is_stamp(cell: str) -> bool:
    """Return whether a cell holds an ISO 8601 time."""
    return bool(_STAMP.fullmatch(cell))


def stamps(path: Path, name: str, column: Any) -> Any:
    """Return a column of ISO 8601 texts as UTC times; raises `BadInput` naming the row of the first that is none."""
    texts = [text.strip().replace(",", ".") for text in column.to_pylist()]
    bad = next((i for i, text in enumerate(texts) if not is_stamp(text)), None)
    if bad is not None:
        raise BadInput(f"{path}: column '{name}', row {bad + 1} holds '{texts[bad]}'; expected a time such as 2026-11-21T10:00:00.125+01:00")
    zoned = [bool(re.search(r"(Z|[+-]\d\d:?\d\d)$", text[10:])) for text in texts]
    if any(zoned) and not all(zoned):
        raise BadInput(f"{path}: column '{name}', row {zoned.index(not zoned[0]) + 1} holds '{texts[zoned.index(not zoned[0])]}'; expected a zone in all rows or in none")
    return pa.array(texts).cast(pa.timestamp("ns", "UTC" if all(zoned) else None)).to_numpy(zero_copy_only=False)


def _name_bad_cell(path: Path, header: list[str], timed: list[str], delimiter: str, point: str, named: bool) -> None:
    """Raise `BadInput` naming row and column of the first cell that is not a number, or the row of another length."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        for row, cells in enumerate(csv.reader(file, delimiter=delimiter), 0 if named else 1):
            if row == 0 or not cells:
                continue
            if len(cells) != len(header):
                expected = f"expected {len(header)}, as many as the header"
                cure = " (commas as decimal signs need ';' between cells)" if delimiter == "," and len(cells) == 2 * len(header) else ""
                raise BadInput(f"{path}: row {row} has {len(cells)} cells; {expected}{cure}")
            for name, cell in zip(header, cells, strict=True):
                if name not in timed and not _is_number(cell.replace(point, ".")):
                    raise BadInput(f"{path}: column '{name}', row {row} holds '{cell}'; expected {_expected(cell, row)}")


def _expected(cell: str, row: int) -> str:
    """Return what a cell that is not a number should be."""
    if re.search(r"\d[./-]\d+[./-]\d+\D+\d+:\d", cell):
        return "a number of seconds, or a time such as 2026-11-21T10:00:00.125+01:00 (ISO 8601)"
    return "a number" + ("; the first line has to hold the names of columns, and no comment or line of units may come before the numbers" if row == 1 else "")


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _parquet(path: Path) -> Columns:
    with pyarrow.parquet.ParquetFile(path) as file:
        _refuse_parquet(path, file)
        table = file.read()
    return {name: _numbers(path, name, table[name].to_numpy()) for name in table.column_names}


def _refuse_parquet(path: Path, file: Any) -> None:
    """Raise `BadInput` for what would not fit into memory, judged before anything is decoded."""
    _refuse_names(path, file.schema_arrow.names)
    refuse_more(path, file.metadata.num_columns, BOUNDS.columns, "columns")
    refuse_more(path, 8 * file.metadata.num_rows * file.metadata.num_columns, table_bytes(path.stat().st_size), "bytes of numbers")
    for field in file.schema_arrow:
        if not any(fits(field.type) for fits in _FLAT):
            raise BadInput(f"{path}: column '{field.name}' holds {field.type} values; expected real numbers")


_FLAT = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean, pa.types.is_temporal, pa.types.is_null, pa.types.is_decimal)


def _npz(path: Path) -> Columns:
    with path.open("rb") as file:
        archive = np.load(file, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise BadInput(f"{path}: holds one array; expected an archive of named columns")
        _refuse_names(path, archive.files)
        refuse_more(path, sum(i.file_size for i in (archive.zip.infolist() if archive.zip else [])), table_bytes(path.stat().st_size), "bytes of numbers")
        return _named(path, archive.items())


def _mat(path: Path) -> Columns:
    if h5py.is_hdf5(path):
        with h5py.File(path) as file:
            found = dict(_datasets(path, file))
            size = sum(int(d.size) * d.dtype.itemsize for d in found.values())
            refuse_more(path, size, table_bytes(path.stat().st_size), "bytes of numbers")
            return _named(path, ((name, dataset[()]) for name, dataset in found.items()))
    data = path.read_bytes()
    variables = read_mat5(data, table_bytes(len(data)))
    only = next(iter(variables.values())) if len(variables) == 1 else None
    return _named(path, (only if isinstance(only, dict) else variables).items())


def _datasets(path: Path, group: Any) -> Iterable[tuple[str, Any]]:
    """Yield the datasets by name, none of them read yet; raises `BadInput` for one whose numbers lie elsewhere."""
    refuse_more(path, len(group), BOUNDS.columns, "variables")
    names = [name for name in group if not name.startswith("#")]
    for name in names:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise BadInput(f"{path}: variable '{name}' is a link to another place; expected the numbers themselves")
    if len(names) == 1 and isinstance(group[names[0]], h5py.Group):
        yield from _datasets(path, group[names[0]])
        return
    for name in names:
        found = group[name]
        if isinstance(found, h5py.Group):
            raise BadInput(f"{path}: variable '{name}' is a struct beside others; expected vectors of numbers")
        if not isinstance(found, h5py.Dataset) or found.external or found.is_virtual:
            raise BadInput(f"{path}: variable '{name}' keeps its numbers in another file; expected them in this one")
        yield name, found


def _named(path: Path, variables: Iterable[tuple[str, Any]]) -> Columns:
    """Return vectors as columns, and the columns of a matrix as ``name_1``, ``name_2``, ...; its longer side is time."""
    found: Columns = {}
    for name, value in variables:
        matrix = np.asarray(value)
        if matrix.ndim == 2 and min(matrix.shape) > 1:
            matrix = matrix if matrix.shape[0] > matrix.shape[1] else matrix.T
            refuse_more(path, matrix.shape[1], BOUNDS.columns, f"columns in '{name}'")
            found |= {f"{name}_{j + 1}": _numbers(path, name, matrix[:, j]) for j in range(matrix.shape[1])}
        else:
            found[name] = _numbers(path, name, matrix)
    return found


@contextmanager
def _tdms_file(path: Path) -> Iterator[Any]:
    """Open a TDMS file; raises `BadInput` without the library that reads it."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError:
        raise BadInput(f"{path}: TDMS needs the extra 'tdms': install afdsvc[tdms]") from None
    log_manager.set_level(logging.CRITICAL)  # it would print bytes of the file
    with opened(path) as stream, TdmsFile.open(stream) as file:
        yield file


def _channels(file: Any) -> dict[str, Any]:
    """Return the channels of a TDMS file that hold samples, by name (``group/channel`` where a name comes twice)."""
    channels = [c for group in file.groups() for c in group.channels() if len(c)]
    often = Counter(c.name for c in channels)
    return {c.name if often[c.name] == 1 else f"{c.group_name}/{c.name}": c for c in channels}


def _tdms(path: Path) -> Columns:
    """Return the channels by name, and the time that their properties state as ``t``."""
    with _tdms_file(path) as file:
        if file.file_status.incomplete_final_segment:
            log.warning("%s: the file ends within a segment; what is whole is read", path)
        return _tdms_columns(path, _channels(file))


def _tdms_columns(path: Path, channels: dict[str, Any]) -> Columns:
    refuse_more(path, len(channels), BOUNDS.columns, "channels")
    refuse_more(path, 8 * sum(map(len, channels.values())), table_bytes(path.stat().st_size), "bytes of samples")
    if not channels:
        raise BadInput(f"{path}: not a readable .tdms file: it holds no samples")
    found = {name: _numbers(path, name, np.asarray(c[:])) for name, c in channels.items()}
    steps = {(c.properties.get("wf_increment"), c.properties.get("wf_start_offset", 0.0)) for c in channels.values()}
    step, start = steps.pop() if len(steps) == 1 else (None, 0.0)
    if step and "t" not in found:
        found = {"t": start + step * np.arange(len(next(iter(found.values())))), **found}
    return found


def _numbers(path: Path, name: str, values: Any) -> Array:
    """Return a vector of doubles; raises `BadInput` for other shapes and types and integers no double can hold."""
    if values.dtype.kind == "M":
        return np.asarray(values.astype("datetime64[ns]").reshape(-1))
    if values.dtype.kind not in "fiub":
        raise BadInput(f"{path}: column '{name}' holds {values.dtype} values; expected real numbers")
    if values.size != max(values.shape, default=1):
        raise BadInput(f"{path}: column '{name}' has shape {values.shape}; expected a vector")
    flat = values.reshape(-1)
    numbers: Array = flat.astype(np.float64)
    if flat.dtype.kind in "iu" and not np.array_equal(numbers.astype(flat.dtype), flat):
        raise BadInput(f"{path}: column '{name}' holds integers beyond 2**53, which a double cannot hold")
    return numbers


def _refuse_names(path: Path, names: list[str]) -> None:
    """Raise `BadInput` for too many columns, or one that comes twice."""
    refuse_more(path, len(names), BOUNDS.columns, "columns")
    name, times = max(Counter(names).items(), key=lambda pair: pair[1], default=("", 0))
    if times > 1:
        raise BadInput(f"{path}: column '{name}' comes {'twice' if times == 2 else f'{times} times'}; expected once")


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


_READERS: dict[str, Callable[[Path], Columns]] = {".csv": _csv, ".parquet": _parquet, ".mat": _mat, ".npz": _npz, ".tdms": _tdms}
