"""Files checked against a pydantic model, with errors that name file, key, value found and value expected."""

from __future__ import annotations

import ctypes
import difflib
import re
import stat
import time
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from afdsvc.errors import BadInput


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a file may hold, sizes in bytes after decompression, and how long it may be read: ``seconds``, and one for every ``pace`` bytes.

    Tables are held in memory as a whole, recordings are read chunk by chunk; each may expand to its ``free`` size, beyond that to
    ``expansion`` times the size of the file.
    """

    table: int = 4_000_000_000
    table_free: int = 256_000_000
    table_expansion: int = 100
    recording_free: int = 1_000_000_000
    recording_expansion: int = 200
    chunk: int = 256_000_000
    columns: int = 4096
    line: int = 1_000_000
    text: int = 16_000_000
    seconds: float = 60.0
    pace: int = 1_000_000


BOUNDS = Bounds()
DECIMAL_COMMA = re.compile(r"^[^#\"]*=\s*-?\d+,\d", re.MULTILINE)  # number = 0,5


def table_bytes(size: int) -> int:
    """Return how many bytes a table in a file of ``size`` bytes may hold."""
    return min(BOUNDS.table, max(BOUNDS.table_free, BOUNDS.table_expansion * size))


def recording_bytes(size: int) -> int:
    """Return how many bytes the chunks of a recording of ``size`` bytes may hold."""
    return max(BOUNDS.recording_free, BOUNDS.recording_expansion * size)


def refuse_more(path: Path, found: int, most: int, what: str) -> None:
    """Raise `BadInput` when a file holds more of something than it may."""
    if found > most:
        raise BadInput(f"{path}: holds {found:,} {what}; at most {most:,} are read from this file")


def file_size(path: Path, most: int) -> int:
    """Return the size of a file; raises `BadInput` when it is larger than ``most`` bytes or cannot be read."""
    try:
        size, mode = path.stat().st_size, path.stat().st_mode
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise BadInput(f"{path}: is a device, pipe or socket, which may never end; expected a file")
    refuse_more(path, size, most, "bytes")
    return size


R = TypeVar("R")


def reading_seconds(size: int) -> float:
    """Return how long [s] a file of ``size`` bytes may be read."""
    return BOUNDS.seconds + size / BOUNDS.pace


def in_time(read: Callable[[], R], source: object, size: int) -> R:
    """Return what ``read`` returns, called in a thread of its own; raises `BadInput` when that takes longer than ``size`` bytes may.

    The thread is then made to end with its next step in Python: some libraries take hours for a few kilobytes.
    """
    found: Future[R] = Future()
    thread = Thread(target=_work, args=(read, found), name="reader", daemon=True)
    thread.start()
    thread.join(reading_seconds(size))
    if thread.is_alive():
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit))
        raise _too_slow(source, size)
    return found.result()


def items_in_time(items: Iterator[R], source: object, size: int) -> Iterator[R]:
    """Yield what is read piece by piece; raises `BadInput` when the reading alone takes more processor time than ``size`` bytes may."""
    most, used = reading_seconds(size), 0.0
    while used < most:
        began = time.thread_time()
        try:
            item = next(items)
        except StopIteration:
            return
        used += time.thread_time() - began
        yield item
    raise _too_slow(source, size)


def _work(read: Callable[[], R], found: Future[R]) -> None:
    try:
        found.set_result(read())
    except BaseException as error:
        found.set_exception(error)


def _too_slow(source: object, size: int) -> BadInput:
    return BadInput(f"{source}: is still being read after {reading_seconds(size):.3g} s; at most that long is spent on {size:,} bytes")


class Strict(BaseModel):
    """A table of a TOML file: unknown keys are errors, text is not taken for numbers, nothing is changed afterwards."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


T = TypeVar("T", bound=BaseModel)


def read_text(path: Path) -> str:
    """Return a UTF-8 text file; raises `BadInput` naming the file when it cannot be read."""
    file_size(path, BOUNDS.text)
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not UTF-8; expected a text file") from None


def toml_table(text: str, source: str) -> dict[str, Any]:
    """Return the table of a TOML text; raises `BadInput` naming the source, line and column of an error."""
    try:
        return in_time(lambda: tomllib.loads(text), source, len(text))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        comma = "; the decimal sign is a point" if DECIMAL_COMMA.search(text) else ""
        raise BadInput(f"{source}: not a TOML file: {error}{comma}") from None


def validated(schema: type[T], data: object, source: str) -> T:
    """Return the data as the schema describes it; raises `BadInput` listing every offence, one clause each."""
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        offences: dict[str, str] = {}
        for e in error.errors(include_url=False):
            offences.setdefault(_dotted(e["loc"]) or e["msg"], _sentence(schema, e))  # where several types were tried, the first speaks
        raise BadInput(f"{source}: {'; and '.join(offences.values())}") from None


def _sentence(schema: type[BaseModel], error: Any) -> str:
    key, kind, message = _dotted(error["loc"]), error["type"], str(error["msg"])
    if kind == "missing":
        return f"key '{key}' is missing; {_expected_keys(schema, error['loc'])}"
    if kind == "extra_forbidden":
        expected = _expected_keys(schema, error["loc"])
        near = difflib.get_close_matches(str(error["loc"][-1]), expected.replace(",", "").split(), 1, 0.6)
        return f"key '{key}' is not known; " + (f"is '{near[0]}' meant? " if near else "") + expected
    found = _shortened(error["input"])
    if kind == "value_error":
        detail = message.removeprefix("Value error, ")
        given = f" is {found};" if isinstance(error["input"], str | int | float) else ":"
        return f"key '{key}'{given} {detail}" if key else detail
    return f"key '{key}' is {found}; expected {_expected(schema, error)}"


TYPES = {"float_type": "a number", "int_type": "a whole number", "int_from_float": "a whole number", "string_type": "text", "bool_type": "true or false",
         "dict_type": "a table", "finite_number": "a finite number"}  # fmt: skip


def _expected(schema: type[BaseModel], error: Any) -> str:
    """Return what belongs in the place of an error: a type, an example where field or table have one, or a limit."""
    kind, context, field, table = error["type"], error.get("ctx", {}), None, schema
    for part in error["loc"]:
        if part in getattr(table, "model_fields", {}):
            field = table.model_fields[part]
            table = _inner(field.annotation)
    example = getattr(table, "EXPECTED", "") or f"a table with the keys {', '.join(getattr(table, 'model_fields', {}))}"
    if kind == "model_type":
        return example
    if kind == "list_type":
        entries = f"a list, each entry {example}" if hasattr(table, "model_fields") else "a list"
        return field.description if field and field.description and not _dotted(error["loc"]).endswith("]") else entries
    words = str(error["msg"]).removeprefix("Input should be ")
    limits = {"greater_than": "a number above {gt:g}", "greater_than_equal": "a number of at least {ge:g}", "less_than": "a number below {lt:g}",
              "less_than_equal": "a number of at most {le:g}", "too_short": "at least {min_length} entries, not {actual_length}",
              "string_too_short": "text that is not empty"}  # fmt: skip
    return TYPES.get(kind) or (limits[kind].format(**context) if kind in limits else words[0].lower() + words[1:])


def _dotted(location: tuple[int | str, ...]) -> str:
    """Return a place in a file as people write it: ``inputs[0].unit``."""
    text = ""
    for part in location:
        if isinstance(part, int) or not ("[" in part or part in ("float", "int", "str")):  # other parts name one of several types that were tried
            text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _shortened(value: object, longest: int = 60) -> str:
    """Return a value as it can stand inside a sentence."""
    text = repr(value)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def _expected_keys(schema: type[BaseModel], location: tuple[int | str, ...]) -> str:
    known = _fields_at(schema, location[:-1])
    return f"known here are {', '.join(known)}" if known else "no key is expected here"


def _fields_at(schema: Any, location: tuple[int | str, ...]) -> list[str]:
    for part in location:
        schema = _inner(schema.model_fields[part].annotation) if part in getattr(schema, "model_fields", {}) else schema
    return list(getattr(schema, "model_fields", {}))


def _inner(annotation: Any) -> Any:
    """Return the table inside ``list[Table]``, ``dict[str, Table]`` or ``Table | None``."""
    while get_args(annotation):
        arguments = [a for a in get_args(annotation) if a is not type(None) and a is not str]
        annotation = arguments[-1] if arguments else None
    return annotation
