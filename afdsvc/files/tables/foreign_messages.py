"""Foreign messages as numbers: protobuf, JSON and ROS 2, fields by path, and their time stamps."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from typing import Any

from mcap.records import Channel, Schema

from afdsvc.errors import BadInput

Decode = Callable[[bytes], Any]
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")
_STAMPS = ("header.stamp", "timestamp", "stamp")
_SECONDS, _NANOS = ("sec", "seconds", "secs"), ("nanosec", "nanos", "nsec", "nsecs")
_SHOWN = 12
_LATEST = 9e9  # seconds; the year 2255, and what 64 bits of ns hold


def decoder(channel: Channel, schema: Schema | None, where: str) -> Decode:
    """Return the function from bytes to a message; raises `BadInput` for an encoding that is not read."""
    encoding = channel.message_encoding
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory

        return _of(DecoderFactory(), "protobuf", schema, where)
    if encoding == "cdr":
        return _ros2(schema, where)
    raise BadInput(f"{where}: messages are encoded as '{encoding}'; expected protobuf, json or cdr (ROS 2)")


def _ros2(schema: Schema | None, where: str) -> Decode:
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise BadInput(f"{where}: is a ROS 2 topic, which needs the extra 'ros': install afdsvc[ros]") from None
    return _of(DecoderFactory(), "cdr", schema, where)


def _of(factory: Any, encoding: str, schema: Schema | None, where: str) -> Decode:
    try:
        found: Decode | None = factory.decoder_for(encoding, schema)
    except Exception as error:
        raise BadInput(f"{where}: its schema cannot be read: {_why(error)}") from None
    if found is None:
        given = "none" if schema is None else f"'{schema.encoding}'"
        raise BadInput(f"{where}: its schema is {given}, which does not describe {encoding} messages")
    return found


def number(message: Any, path: str, where: str) -> float:
    """Return the number at a path such as ``pose.position.x`` or ``current[0]``; raises `BadInput` naming what there is."""
    value = _at(message, path)
    if isinstance(value, Real):  # bool and numpy numbers too
        try:
            return float(value)
        except OverflowError:
            raise BadInput(f"{where}: holds a whole number of {len(str(value))} digits; expected one a double can hold") from None
    found = "has no such field" if value is None else f"holds {type(value).__name__} there"
    there = [name for _, name in zip(range(_SHOWN + 1), numeric_paths(message), strict=False)]
    listed = ", ".join(there[:_SHOWN]) + (", ..." if len(there) > _SHOWN else "")
    raise BadInput(f"{where}: {found}; expected a number, and it has {listed or 'none'}")


def _at(message: Any, path: str) -> Any:
    """Return what stands at a path, None where there is nothing."""
    for name, index in _STEP.findall(path):
        try:
            message = message[int(index)] if index else _child(message, name)
        except (IndexError, KeyError, TypeError):
            return None
        if message is None:
            return None
    return message


def stamp_ns(message: Any) -> int | None:
    """Return the time a message carries in its header [ns], None where it carries none or an empty one."""
    for path in _STAMPS:
        found = _at(message, path)
        parts = [_first(found, names) for names in (_SECONDS, _NANOS)]
        if all(isinstance(part, (int, float)) and -_LATEST < part < _LATEST for part in parts):
            return (int(parts[0]) * 10**9 + int(parts[1])) or None
    return None


def numeric_paths(message: Any, before: str = "") -> Iterator[str]:
    """Yield the paths of all numbers in a message."""
    if isinstance(message, Real):
        yield before
    elif isinstance(message, (str, bytes)) or message is None:
        return
    elif hasattr(message, "__len__") and hasattr(message, "__getitem__") and not isinstance(message, Mapping):
        for i in range(min(len(message), _SHOWN)):
            yield from numeric_paths(message[i], f"{before}[{i}]")
    else:
        for name in _names(message):
            yield from numeric_paths(_child(message, name), f"{before}.{name}" if before else name)


def _child(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def _names(message: Any) -> list[str]:
    if isinstance(message, Mapping):
        return [str(name) for name in message]
    if hasattr(message, "DESCRIPTOR"):
        return [field.name for field in message.DESCRIPTOR.fields]
    return [name for name in getattr(message, "__slots__", ()) if not name.startswith("_")]


def _first(message: Any, names: tuple[str, ...]) -> Any:
    return next((v for v in (_at(message, name) for name in names) if v is not None), None)


def _why(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
