"""Bytes to a protobuf message and checked fields; whatever is wrong with them is `BadInput`."""

from __future__ import annotations

import json
import math
from typing import Any, TypeVar

from google.protobuf.message import DecodeError, EncodeError, Message
from google.protobuf.timestamp_pb2 import Timestamp

from afdsvc.errors import BadInput

M = TypeVar("M", bound=Message)
_END = 2**63  # counters and nanoseconds fit a signed 64-bit integer, as numpy and every reader expect


def parse(kind: type[M], data: bytes) -> M:
    """Return the message; raises `BadInput` for bytes that are not one."""
    try:
        return kind.FromString(data)
    except (DecodeError, TypeError, ValueError) as error:
        name = kind.DESCRIPTOR.name
        raise BadInput(f"{len(data)} bytes are no {name} message of afdsvc.v1: {error}") from None


def build_message(kind: type[M], /, **fields: Any) -> M:
    """Return a message; raises `BadInput` naming its kind when a value does not fit its field."""
    try:
        return kind(**fields)
    except (TypeError, ValueError, EncodeError) as error:
        raise BadInput(f"a value does not fit into the {kind.DESCRIPTOR.name} message: {error}") from None


def required(message: Any, *names: str) -> None:
    """Raise `BadInput` for the first field that is empty or absent."""
    for name in names:
        field = message.DESCRIPTOR.fields_by_name[name]
        present = message.HasField(name) if field.has_presence else getattr(message, name)
        if not present:
            raise BadInput(f"{message.DESCRIPTOR.name} message without {name}: {_where(message)}")


def count(message: Any, name: str) -> int:
    """Return a counter; raises `BadInput` when it is beyond any count."""
    value = int(getattr(message, name))
    if value >= _END:
        found = f"{name} = {value}"
        raise BadInput(f"{message.DESCRIPTOR.name} message with {found}; expected below 2**63: {_where(message)}")
    return value


def positive(message: Any, name: str) -> float:
    """Return a number; raises `BadInput` unless it is finite and above 0."""
    value = float(getattr(message, name))
    if not (math.isfinite(value) and value > 0):
        raise BadInput(f"{message.DESCRIPTOR.name} message with {name} = {value}; expected a positive number: {_where(message)}")
    return value


def stamp(t_ns: int) -> Timestamp:
    """Return Unix nanoseconds as a timestamp; raises `BadInput` outside 1970 to 2262."""
    if not 0 <= t_ns < _END:
        raise BadInput(f"time stamp {t_ns} ns; expected Unix nanoseconds from 0 to 2**63")
    return Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)


def nanoseconds(timestamp: Timestamp) -> int:
    """Return a timestamp as Unix nanoseconds; raises `BadInput` as `stamp`."""
    t_ns = timestamp.seconds * 10**9 + timestamp.nanos
    if not (0 <= timestamp.nanos < 10**9 and 0 <= t_ns < _END):
        raise BadInput(f"time stamp of {timestamp.seconds} s and {timestamp.nanos} ns; expected a Unix time")
    return t_ns


def json_text(what: str, value: Any) -> str:
    """Return a value as JSON; raises `BadInput` for what JSON cannot say, NaN among it."""
    try:
        return json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{what} cannot be written as JSON: {error}") from None


def json_value(what: str, text: str) -> Any:
    """Return the value of a JSON text; raises `BadInput` when it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{what} is not JSON: {error}") from None


def _where(message: Any) -> str:
    machine = getattr(message, "machine", "")
    return f"machine '{machine}'" if machine else "no machine named"
