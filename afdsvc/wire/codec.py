"""The one codec of transport and recordings: values to bytes, bytes to values.

The descriptors of `afdsvc.proto` say how a field travels; `RULES` says what they cannot: which fields are required, which numbers are
positive, which fields of a value have another form in the message. A class and its message share their name and the names of
their fields; a timestamp ``x`` is the attribute ``x_ns``, 0 when it is absent. Blocks, the bulk of all traffic, have a codec of their own.

Every decoder raises `afdsvc.errors.BadInput`, and nothing else, for bytes that are not what they should be.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from google.protobuf.descriptor import FieldDescriptor

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.retuning import DiagnosedFault, Promise, Tuning
from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire.block_codec import decode_block, encode_block
from afdsvc.wire.keys import checked_machine
from afdsvc.wire.messages import (
    Alarm,
    AlarmChange,
    AlarmKind,
    BurstReply,
    BurstRequest,
    BurstStop,
    Command,
    CommandReply,
    EventKind,
    Finding,
    Lease,
    MachineStatus,
    Receipt,
    Residual,
    RetuneRequest,
    RigDescription,
    RigEvent,
    ServiceStatus,
)
from afdsvc.wire.parsing import build_message, count, json_text, json_value, nanoseconds, parse, positive, required, stamp

__all__ = ["Message", "decode", "decode_block", "encode", "encode_block"]

T = TypeVar("T")
Fields = dict[str, Any]


def encode(value: Any) -> bytes:
    """Return the message of a value, numbers bit for bit; raises `BadInput` for what it cannot hold."""
    if isinstance(value, Block | Residual):
        return encode_block(value if isinstance(value, Block) else value.block)
    return bytes(_message(value).SerializeToString(deterministic=True))


def decode(kind: type[T], data: bytes) -> T:
    """Return the value of this class; raises `BadInput` naming what is missing or unsound."""
    found: T = _value(kind, parse(RULES[kind].message, data))
    return found


class Message:
    """A value with its bytes: those it came as, or encoded once, when they are first asked for. Any thread may ask."""

    __slots__ = ("_lock", "_payload", "value")

    def __init__(self, value: Any, payload: bytes | None = None) -> None:
        self.value, self._payload, self._lock = value, payload, threading.Lock()

    @property
    def payload(self) -> bytes:
        """The bytes; raises `BadInput` as `encode`."""
        with self._lock:
            if self._payload is None:
                self._payload = encode(self.value)
            return self._payload


def _message(value: Any) -> Any:
    rule = RULES[type(value)]
    attributes = rule.taken_apart(value)
    return build_message(rule.message, **{f.name: f.write(attributes[f.attribute]) for f in _FIELDS[type(value)]})


def _value(kind: type[Any], message: Any) -> Any:
    rule = RULES[kind]
    required(message, *rule.required)
    if rule.unless and not getattr(message, rule.unless[0]):
        required(message, rule.unless[1])
    attributes = {f.attribute: f.read(message) for f in _FIELDS[kind]}
    rule.check(message)
    return rule.put_together(attributes)


@dataclass(frozen=True, slots=True)
class _Field:
    """How one field of a message is written from an attribute, and the attribute read from the message."""

    name: str
    attribute: str
    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


def _fields(rule: Rule) -> tuple[_Field, ...]:
    return tuple(_Field(f.name, _attribute(f), _writer(rule, f), _reader(rule, f)) for f in rule.message.DESCRIPTOR.fields)


def _attribute(f: FieldDescriptor) -> str:
    """Return the name of the attribute that a field of a message holds."""
    return {"timestamp": "t_ns"}.get(f.name, f"{f.name}_ns") if _nested_type(f) == "Timestamp" else f.name


def _nested_type(f: FieldDescriptor) -> str:
    """Return the name of the message a field holds, "map" for a map, "" for numbers and texts."""
    if f.message_type is None:
        return ""
    return "map" if f.message_type.GetOptions().map_entry else str(f.message_type.name)


def _writer(rule: Rule, f: FieldDescriptor) -> Callable[[Any], Any]:
    """Return the function from an attribute to what its field is set to, None for a field that stays absent."""
    nested = _nested_type(f)
    if f.name in rule.forms:
        return rule.forms[f.name].write
    if nested == "Timestamp":
        return stamp if f.name in rule.required else lambda t_ns: stamp(t_ns) if t_ns else None
    if nested == "NamedValue":
        return lambda numbers: [build_message(pb.NamedValue, name=name, value=value) for name, value in numbers.items()]
    if nested not in ("", "map"):
        return (lambda values: [_message(v) for v in values]) if f.is_repeated else lambda value: None if value is None else _message(value)
    if f.is_repeated and f.type == FieldDescriptor.TYPE_DOUBLE:
        return lambda array: array.ravel().tolist()
    return dict if nested else lambda value: value


def _reader(rule: Rule, f: FieldDescriptor) -> Callable[[Any], Any]:
    """Return the function from a message to the attribute that one of its fields gives."""
    name, form = f.name, rule.forms.get(f.name)
    if form is not None:
        return lambda message: form.read(message, getattr(message, name))
    if f.is_repeated:
        many = _many_reader(f)
        return lambda message: many(getattr(message, name))
    if _nested_type(f) == "Timestamp":
        return lambda message: nanoseconds(getattr(message, name)) if message.HasField(name) else 0
    one = _one_reader(rule, f)
    return (lambda message: one(message) if message.HasField(name) else None) if f.has_presence else one


def _many_reader(f: FieldDescriptor) -> Callable[[Any], Any]:
    nested = _nested_type(f)
    if nested == "NamedValue":
        return _by_name
    if nested in ("", "map"):
        return dict if nested else tuple if f.type != FieldDescriptor.TYPE_DOUBLE else lambda values: np.array(values, dtype=float)
    return lambda values: tuple(_value(_CLASSES[nested], v) for v in values)


def _one_reader(rule: Rule, f: FieldDescriptor) -> Callable[[Any], Any]:
    name, nested = f.name, _nested_type(f)
    if nested:
        return lambda message: _value(_CLASSES[nested], getattr(message, name))
    if name == "machine":
        return lambda message: checked_machine(message.machine)
    if f.type == FieldDescriptor.TYPE_UINT64:
        return lambda message: count(message, name)
    return (lambda message: positive(message, name)) if name in rule.positive else attrgetter(name)


def _by_name(values: Iterable[pb.NamedValue]) -> dict[str, float]:
    found: dict[str, float] = {}
    for item in values:
        if item.name in found:
            raise BadInput(f"value '{item.name}' is given twice; expected once")
        found[item.name] = item.value
    return found


@dataclass(frozen=True, slots=True)
class Form:
    """Another form of one attribute in its message: ``write`` takes the attribute, ``read`` the message and its field."""

    write: Callable[[Any], Any]
    read: Callable[[Any, Any], Any]


def _attributes(value: Any) -> Fields:
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}


@dataclass(frozen=True, slots=True)
class Rule:
    """What the descriptor of a message does not say of its fields.

    The second field of ``unless`` is required where the first is not true; ``check`` raises `BadInput` for fields that do not fit together.
    """

    message: Any
    put_together: Callable[[Fields], Any]
    required: tuple[str, ...] = ()
    unless: tuple[str, ...] = ()
    positive: tuple[str, ...] = ()
    forms: Mapping[str, Form] = field(default_factory=dict)
    check: Callable[[Any], None] = lambda message: None
    taken_apart: Callable[[Any], Fields] = _attributes


def _event_kind(message: pb.RigEvent, number: int) -> EventKind:
    name = pb.RigEvent.Kind.Name(number) if number in pb.RigEvent.Kind.values() else ""
    if name not in EventKind.__members__:
        raise BadInput(f"event of machine '{message.machine}' has kind {number}; expected one of {', '.join(EventKind)}")
    return EventKind[name]


def _alarm_kind(message: pb.Alarm, value: str) -> AlarmKind:
    try:
        return AlarmKind(value or "fault")
    except ValueError:
        raise BadInput(f"an alarm of kind '{value[:40]}'; expected fault, system or notice") from None


def _arguments(message: pb.Command, text: str) -> dict[str, Any]:
    arguments = json_value(f"arguments of command '{message.name}'", text or "{}")
    if not isinstance(arguments, dict):
        raise BadInput(f"arguments of command '{message.name}' are {text[:40]}; expected a JSON object")
    return arguments


def _ranges(message: pb.Receipt, values: Iterable[pb.SampleRange]) -> tuple[tuple[str, int, int], ...]:
    ranges = tuple((r.session, count(r, "start"), count(r, "end")) for r in values)
    for session, start, end in ranges:
        if end < start:
            raise BadInput(f"Receipt message with samples {start} to {end} of session '{session[:40]}'; expected an end behind the start")
    return ranges


def _waveform(message: pb.Burst, columns: Any) -> Array | None:
    if not columns:
        return None
    lengths = [len(column.values) for column in columns]
    if lengths != [message.samples] * message.inputs:
        raise BadInput(f"burst '{message.name}': waveform columns of {lengths} samples; expected {message.inputs} of {message.samples} samples")
    return np.array([column.values for column in columns]).T.copy()


def _columns(waveform: Array | None) -> list[pb.Column]:
    return [] if waveform is None else [build_message(pb.Column, values=c.tolist()) for c in waveform.T]


def _finite_burst(message: pb.Burst) -> None:
    numbers = [(x.omega, x.amplitude, x.phase) for x in message.lines] + [column.values for column in message.waveform]
    if not all(math.isfinite(v) for values in numbers for v in values):
        raise BadInput(f"burst '{message.name}' contains NaN or infinity; expected finite numbers")


def _bounds(message: pb.RigDescription) -> None:
    limits = message.limits
    if not all(v >= 0 for values in (limits.output, limits.input, limits.alpha) for v in values):
        raise BadInput(f"limits of machine '{message.machine}' are negative or NaN; expected bounds of 0 or more")


def _evidence(finding: Finding) -> Fields:
    return _attributes(finding.evidence) | {"session": finding.session, "t_ns": finding.t_ns}


def _finding(fields: Fields) -> Finding:
    session, t_ns = fields.pop("session"), fields.pop("t_ns")
    return Finding(Evidence(**fields), session, t_ns)


def _numbers(*matrices: Array) -> Array:
    return np.concatenate([M.ravel() for M in matrices])


def _retuning(request: RetuneRequest) -> Fields:
    Q, tuning, found = request.tuning.Q, request.tuning, request.found
    size = {"states": Q.order, "inputs": Q.outputs, "outputs": Q.inputs, "matrices": _numbers(Q.A, Q.B, Q.C, Q.D), "dt": Q.dt}
    return _attributes(request) | size | _attributes(found) | {"rise": tuning.rise, "fall": tuning.fall, "promise": tuning.promise}


def _finite_retuning(m: pb.RetuneRequest) -> None:
    n, rows, columns = m.states, m.inputs, m.outputs
    if len(m.matrices) != (n + rows) * (n + columns):
        raise BadInput(f"RetuneRequest message with {len(m.matrices)} numbers; expected {(n + rows) * (n + columns)}, those of Q with {n} states, {rows} x {columns}")
    if not all(math.isfinite(v) for v in (*m.matrices, m.rise, m.fall, m.low, m.high, *m.promise.output, *m.promise.input)):
        raise BadInput("RetuneRequest message contains NaN or infinity; expected finite numbers")
    if min(m.rise, m.fall) < 0:
        raise BadInput(f"RetuneRequest message with times {m.rise} and {m.fall} s; expected 0 or more")
    if m.HasField("promise") and (len(m.promise.output), len(m.promise.input)) != (columns**2, rows**2):
        found = f"weights of {len(m.promise.output)} and {len(m.promise.input)} numbers"
        raise BadInput(f"RetuneRequest message with {found}; expected {columns**2} and {rows**2}")


def _retune_request(fields: Fields) -> RetuneRequest:
    n, rows, columns = (fields.pop(name) for name in ("states", "inputs", "outputs"))
    shapes = ((n, n), (n, columns), (rows, n), (rows, columns))
    parts = np.split(fields.pop("matrices"), np.cumsum([a * b for a, b in shapes])[:-1])
    A, B, C, D = (part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))
    promise = fields.pop("promise")
    if promise is not None:
        promise = dataclasses.replace(promise, output=promise.output.reshape(columns, columns), input=promise.input.reshape(rows, rows))
    tuning = Tuning(StateSpace(A, B, C, D, fields.pop("dt")), fields.pop("rise"), fields.pop("fall"), promise)
    found = DiagnosedFault(fields.pop("fault"), fields.pop("low"), fields.pop("high"))
    return RetuneRequest(tuning=tuning, found=found, **fields)


def _plain(kind: type[Any], message: Any, **rule: Any) -> dict[type[Any], Rule]:
    return {kind: Rule(message, lambda fields: kind(**fields), **rule)}


_SAMPLE = ("machine", "session", "timestamp")
RULES: dict[type[Any], Rule] = {
    **_plain(Severity, pb.Severity),
    **_plain(Channel, pb.ChannelInfo),
    **_plain(Line, pb.Line),
    **_plain(Limits, pb.Limits, positive=("seconds",)),
    **_plain(Promise, pb.Promise, positive=("cost", "seconds")),
    **_plain(Burst, pb.Burst, required=("name", "inputs", "samples"), forms={"waveform": Form(_columns, _waveform)}, check=_finite_burst),
    **_plain(BurstRequest, pb.BurstRequest, required=("machine", "timestamp", "burst", "asked_by"), positive=("lease",)),
    **_plain(BurstReply, pb.BurstReply, unless=("accepted", "reason")),
    **_plain(BurstStop, pb.BurstStop, required=("machine", "reason", "asked_by")),
    **_plain(Lease, pb.Lease, required=("machine", "burst"), positive=("seconds",)),
    **_plain(
        Receipt, pb.Receipt, required=("machine",),
        forms={"ranges": Form(lambda rs: [build_message(pb.SampleRange, session=s, start=start, end=end) for s, start, end in rs], _ranges)},
    ),
    **_plain(RigEvent, pb.RigEvent, required=_SAMPLE, forms={"kind": Form(lambda kind: pb.RigEvent.Kind.Value(kind.name), _event_kind)}),
    **_plain(RigDescription, pb.RigDescription, required=(*_SAMPLE, "channels"), positive=("dt",), check=_bounds),
    **_plain(Alarm, pb.Alarm, required=("id", "machine", "since", "last"), forms={"kind": Form(str, _alarm_kind)}),
    **_plain(AlarmChange, pb.AlarmChange, required=("timestamp", "alarm", "event")),
    **_plain(MachineStatus, pb.MachineStatus, required=("machine", "state")),
    **_plain(ServiceStatus, pb.ServiceStatus, required=("site", "timestamp")),
    **_plain(
        Command, pb.Command, required=("name",),
        forms={"arguments": Form(lambda arguments: json_text("arguments of a command", dict(arguments)), _arguments)},
    ),
    **_plain(
        CommandReply, pb.CommandReply, unless=("ok", "error"),
        forms={"result": Form(lambda result: json_text("result", result), lambda _, text: json_value("result", text or "null"))},
    ),
    Finding: Rule(pb.Evidence, _finding, (*_SAMPLE, "detector"), ("trustworthy", "reason"), taken_apart=_evidence),
    RetuneRequest: Rule(
        pb.RetuneRequest, _retune_request, ("machine", "timestamp", "name", "inputs", "outputs", "asked_by", "fault"),
        positive=("lease", "dt"), check=_finite_retuning, taken_apart=_retuning,
    ),
}
_CLASSES = {rule.message.DESCRIPTOR.name: kind for kind, rule in RULES.items()}
_FIELDS = {kind: _fields(rule) for kind, rule in RULES.items()}
