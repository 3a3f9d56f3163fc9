"""The mapped topics of a foreign MCAP file as columns with the time of each topic: protobuf, JSON and ROS 2, fields by path."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain, islice
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Message, Schema

from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_records import Item, Loss
from afdsvc.files.tables.alignment import Group
from afdsvc.files.tables.mapping import OWN_TIMES, Time, converted
from afdsvc.files.tables.rosbag import ros1_decoder
from afdsvc.files.validation import file_size, in_time, refuse_more, table_bytes
from afdsvc.lti.statespace import Array

_MESSAGE = 200  # bytes that a message of no bytes takes in memory
_LOOKED, _LISTED = 10_000, 24  # messages and numbers looked at for the places there are, and places listed


@dataclass
class _Topic:
    """The fields read from a topic (field path by signal) and what was found, one entry per message."""

    name: str
    fields: dict[str, str] = field(default_factory=dict)
    values: list[list[float]] = field(default_factory=list)
    times: dict[str, list[Any]] = field(default_factory=dict)

    def take(self, message: Any, stored: Message, time: Time) -> None:
        """Take one decoded message."""
        self.values.append([number(message, path, f"{self.name}.{path}") for path in self.fields.values()])
        kept = {"log": stored.log_time, "publish": stored.publish_time}
        if time.place in ("header", "auto"):
            kept["header"] = stamp_ns(message) or 0
        for name, value in kept.items():
            self.times.setdefault(name, []).append(value)
        if time.place not in OWN_TIMES:
            self.times.setdefault("field", []).append(number(message, time.place, f"{self.name}.{time.place}"))


def read_topics(path: Path, items: Iterable[Item], places: Mapping[str, str], time: Time) -> tuple[list[Group], list[str]]:
    """Return one group of columns per topic of an MCAP file's records (times in s, from the file's first), and sentences on time and damage.

    ``places`` maps signals to ``topic.field``. Raises `BadInput` for a topic or field that is not there or no number, and for
    messages without the time that was asked for.
    """
    topics, losses = in_time(lambda: _read(path, items, places, time), path, file_size(path, sys.maxsize))
    chosen, sentence = _clock(list(topics.values()), time, path)
    times = _seconds(topics, chosen, time, path)
    groups = []
    for topic in topics.values():
        values = np.array(topic.values, dtype=np.float64)
        groups.append(Group(topic.name, times[topic.name], dict(zip(topic.fields, values.T, strict=True))))
    return groups, [sentence, *losses]


def places_of(path: Path, items: Generator[Item, None, None]) -> list[str]:
    """Return what a mapping may name, ``TOPIC.FIELD`` of the numbers in the first message of each topic; of topics that cannot be decoded the name alone."""
    file, first = _File(), dict[int, Message]()

    def look() -> None:
        with closing(items):  # in the thread that opened the file
            for item in islice(items, _LOOKED):
                if isinstance(item, Message):
                    first.setdefault(item.channel_id, item)
                else:
                    file.take(item, {})

    in_time(look, path, file_size(path, sys.maxsize))
    return sorted(chain.from_iterable(_places(path, c, file.schemas.get(c.schema_id), first[id]) for id, c in file.channels.items() if id in first))


def shown(places: Sequence[str]) -> str:
    """Return the first of places as text, and how many more there are."""
    return ", ".join(places[:_LISTED]) + (f" and {len(places) - _LISTED} more" if len(places) > _LISTED else "") or "no messages"


def _places(path: Path, channel: Channel, schema: Schema | None, message: Message) -> Iterator[str]:
    try:
        found = list(islice(numeric_paths(decoder(channel, schema, f"{path}: topic '{channel.topic}'")(message.data)), _LOOKED))
    except Exception:  # decoders fail in many ways; what matters here is what else there is
        yield channel.topic
        return
    for at in found:
        if not re.match(r"(header|stamp|timestamp)\b", at):
            yield f"{channel.topic}{'' if at.startswith('[') else '.'}{at}"


def _read(path: Path, items: Iterable[Item], places: Mapping[str, str], time: Time) -> tuple[dict[str, _Topic], list[str]]:
    """Return the mapped topics with their decoded samples, and sentences on damage."""
    file, most = _File(), table_bytes(file_size(path, sys.maxsize))
    for item in items:
        file.take(item, places)
        refuse_more(path, file.kept, most, "bytes in mapped messages")
    damage = "".join(f"; {loss}" for loss in file.losses[:1])
    topics = _topics(places, {c.topic: file.kind(c) for c in file.channels.values()}, path, damage)
    for id, messages in file.stored.items():
        channel = file.channels[id]
        if channel.topic in topics:
            decode = decoder(channel, file.schemas.get(channel.schema_id), f"{path}: topic '{channel.topic}'")
            for message in messages:
                _take(topics[channel.topic], decode, message, time, path)
    empty = next((name for name, topic in topics.items() if not topic.values), None)
    if empty is not None:
        raise BadInput(f"{path}: topic '{empty}' has no messages; expected samples{damage}")
    return topics, file.losses


@dataclass
class _File:
    """What of an MCAP file matters: schemas, channels, and the messages of topics that may be mapped."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    stored: dict[int, list[Message]] = field(default_factory=dict)
    losses: list[str] = field(default_factory=list)
    kept: int = 0

    def take(self, item: Item, places: Mapping[str, str]) -> None:
        """Take one record; unmapped topics (images, point clouds) are not kept."""
        if isinstance(item, Schema):
            self.schemas[item.id] = item
        elif isinstance(item, Channel):
            self.channels[item.id] = item
        elif isinstance(item, Loss):
            self.losses.append(f"not all could be read: {item.sentence}")
        elif isinstance(item, Message) and item.channel_id in self.channels:
            topic = self.channels[item.channel_id].topic
            if maps(places, topic):
                self.stored.setdefault(item.channel_id, []).append(item)
                self.kept += len(item.data) + _MESSAGE

    def kind(self, channel: Channel) -> str:
        """Return the type of a channel's messages."""
        schema = self.schemas.get(channel.schema_id)
        return schema.name if schema else channel.message_encoding


def _take(topic: _Topic, decode: Decode, message: Message, time: Time, path: Path) -> None:
    try:
        decoded = decode(message.data)
    except Exception as error:
        raise BadInput(f"{path}: a message of '{topic.name}' cannot be decoded: {type(error).__name__}: {error}") from None
    try:
        topic.take(decoded, message, time)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _topics(places: Mapping[str, str], there: Mapping[str, str], path: Path, damage: str) -> dict[str, _Topic]:
    """Return the topics that are mapped; the longest topic that begins a place is meant."""
    topics: dict[str, _Topic] = {}
    for signal, place in places.items():
        fitting = [name for name in there if _fits(name, place)]
        if not fitting:
            listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(there.items())) or "no messages at all"
            raise BadInput(f"{path}: no topic for '{place}', which is to be {signal}; expected TOPIC.FIELD, and it has {listed}{damage}")
        name = max(fitting, key=len)
        topics.setdefault(name, _Topic(name)).fields[signal] = place[len(name) :].lstrip(".")
    return topics


def maps(places: Mapping[str, str], topic: str) -> bool:
    """Whether something of a topic is mapped."""
    return any(_fits(topic, place) for place in places.values())


def _fits(topic: str, place: str) -> bool:
    return place.startswith((f"{topic}.", f"{topic}["))


def _clock(topics: list[_Topic], time: Time, path: Path) -> tuple[str, str]:
    """Return which of the times counts, and the sentence that says so."""
    if time.place == "log":
        return "log", "the time of a sample is when its message was logged"
    if time.place == "publish":
        return "publish", "the time of a sample is when its message was published"
    if time.place not in OWN_TIMES:
        return "field", f"the time of a sample is field {time.place} [{time.unit}] of its message"
    without = next((t.name for t in topics if not all(t.times["header"])), None)
    if without is None:
        return "header", "the time of a sample is the stamp in its message"
    if time.place == "header":
        raise BadInput(f"{path}: messages of '{without}' carry no stamp (header.stamp, timestamp or stamp); time 'log' is possible")
    return "log", f"messages of '{without}' carry no stamp: the time of a sample is when its message was logged"


def _seconds(topics: Mapping[str, _Topic], chosen: str, time: Time, path: Path) -> dict[str, Array]:
    """Return the times of every topic [s] from the first of all; stamps are subtracted as whole ns, which no double holds."""
    if chosen == "field":
        found = {
            n: converted(np.array(t.times["field"], dtype=np.float64), time.unit, "s", f"{path}: time '{time.place}'")
            for n, t in topics.items()
        }
        first = min(float(np.nanmin(t)) for t in found.values())
        return {name: t - first for name, t in found.items()}
    stamps = {name: np.array(topic.times[chosen], dtype=np.int64) for name, topic in topics.items()}
    zero = min(int(t.min()) for t in stamps.values())
    return {name: (t - zero) / 1e9 for name, t in stamps.items()}


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
    if encoding == "ros1" and schema:
        return ros1_decoder(schema, where)
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
    if isinstance(value, (Real, np.bool_)):  # bool and numpy numbers too
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
    fields: Any = getattr(message, "__dataclass_fields__", None) or getattr(message, "__slots__", ())
    return [name for name in fields if not name.startswith("_")]


def _first(message: Any, names: tuple[str, ...]) -> Any:
    return next((v for v in (_at(message, name) for name in names) if v is not None), None)


def _why(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
