# ruff: noqa
# mypy: ignore-errors
import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Signal(_message.Message):
    __slots__ = ("name", "unit", "values")
    NAME_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    name: str
    unit: str
    values: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., values: _Optional[_Iterable[float]] = ...) -> None: ...

class Block(_message.Message):
    __slots__ = ("timestamp", "machine", "session", "seq", "k0", "dt", "burst", "late", "tuning", "signals")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    K0_FIELD_NUMBER: _ClassVar[int]
    DT_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    TUNING_FIELD_NUMBER: _ClassVar[int]
    SIGNALS_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    session: str
    seq: int
    k0: int
    dt: float
    burst: str
    late: int
    tuning: str
    signals: _containers.RepeatedCompositeFieldContainer[Signal]
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., session: _Optional[str] = ..., seq: _Optional[int] = ..., k0: _Optional[int] = ..., dt: _Optional[float] = ..., burst: _Optional[str] = ..., late: _Optional[int] = ..., tuning: _Optional[str] = ..., signals: _Optional[_Iterable[_Union[Signal, _Mapping]]] = ...) -> None: ...

class Line(_message.Message):
    __slots__ = ("input", "omega", "amplitude", "phase")
    INPUT_FIELD_NUMBER: _ClassVar[int]
    OMEGA_FIELD_NUMBER: _ClassVar[int]
    AMPLITUDE_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    input: int
    omega: float
    amplitude: float
    phase: float
    def __init__(self, input: _Optional[int] = ..., omega: _Optional[float] = ..., amplitude: _Optional[float] = ..., phase: _Optional[float] = ...) -> None: ...

class Column(_message.Message):
    __slots__ = ("values",)
    VALUES_FIELD_NUMBER: _ClassVar[int]
    values: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, values: _Optional[_Iterable[float]] = ...) -> None: ...

class Burst(_message.Message):
    __slots__ = ("name", "inputs", "samples", "ramp", "lines", "waveform", "settle", "purpose", "notes")
    class NotesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    INPUTS_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    RAMP_FIELD_NUMBER: _ClassVar[int]
    LINES_FIELD_NUMBER: _ClassVar[int]
    WAVEFORM_FIELD_NUMBER: _ClassVar[int]
    SETTLE_FIELD_NUMBER: _ClassVar[int]
    PURPOSE_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    name: str
    inputs: int
    samples: int
    ramp: int
    lines: _containers.RepeatedCompositeFieldContainer[Line]
    waveform: _containers.RepeatedCompositeFieldContainer[Column]
    settle: int
    purpose: str
    notes: _containers.ScalarMap[str, str]
    def __init__(self, name: _Optional[str] = ..., inputs: _Optional[int] = ..., samples: _Optional[int] = ..., ramp: _Optional[int] = ..., lines: _Optional[_Iterable[_Union[Line, _Mapping]]] = ..., waveform: _Optional[_Iterable[_Union[Column, _Mapping]]] = ..., settle: _Optional[int] = ..., purpose: _Optional[str] = ..., notes: _Optional[_Mapping[str, str]] = ...) -> None: ...

class BurstRequest(_message.Message):
    __slots__ = ("timestamp", "machine", "burst", "lease", "asked_by", "start", "session", "k")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    ASKED_BY_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    burst: Burst
    lease: float
    asked_by: str
    start: int
    session: str
    k: int
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., burst: _Optional[_Union[Burst, _Mapping]] = ..., lease: _Optional[float] = ..., asked_by: _Optional[str] = ..., start: _Optional[int] = ..., session: _Optional[str] = ..., k: _Optional[int] = ...) -> None: ...

class BurstReply(_message.Message):
    __slots__ = ("accepted", "reason", "burst")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    accepted: bool
    reason: str
    burst: str
    def __init__(self, accepted: _Optional[bool] = ..., reason: _Optional[str] = ..., burst: _Optional[str] = ...) -> None: ...

class BurstStop(_message.Message):
    __slots__ = ("machine", "burst", "reason", "asked_by")
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    ASKED_BY_FIELD_NUMBER: _ClassVar[int]
    machine: str
    burst: str
    reason: str
    asked_by: str
    def __init__(self, machine: _Optional[str] = ..., burst: _Optional[str] = ..., reason: _Optional[str] = ..., asked_by: _Optional[str] = ...) -> None: ...

class Lease(_message.Message):
    __slots__ = ("machine", "burst", "seconds")
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    machine: str
    burst: str
    seconds: float
    def __init__(self, machine: _Optional[str] = ..., burst: _Optional[str] = ..., seconds: _Optional[float] = ...) -> None: ...

class RetuneRequest(_message.Message):
    __slots__ = ("timestamp", "machine", "name", "states", "inputs", "outputs", "matrices", "dt", "rise", "fall", "promise", "fault", "low", "high", "lease", "asked_by", "session", "k", "proof")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    INPUTS_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    MATRICES_FIELD_NUMBER: _ClassVar[int]
    DT_FIELD_NUMBER: _ClassVar[int]
    RISE_FIELD_NUMBER: _ClassVar[int]
    FALL_FIELD_NUMBER: _ClassVar[int]
    PROMISE_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    ASKED_BY_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    PROOF_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    name: str
    states: int
    inputs: int
    outputs: int
    matrices: _containers.RepeatedScalarFieldContainer[float]
    dt: float
    rise: float
    fall: float
    promise: Promise
    fault: str
    low: float
    high: float
    lease: float
    asked_by: str
    session: str
    k: int
    proof: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., name: _Optional[str] = ..., states: _Optional[int] = ..., inputs: _Optional[int] = ..., outputs: _Optional[int] = ..., matrices: _Optional[_Iterable[float]] = ..., dt: _Optional[float] = ..., rise: _Optional[float] = ..., fall: _Optional[float] = ..., promise: _Optional[_Union[Promise, _Mapping]] = ..., fault: _Optional[str] = ..., low: _Optional[float] = ..., high: _Optional[float] = ..., lease: _Optional[float] = ..., asked_by: _Optional[str] = ..., session: _Optional[str] = ..., k: _Optional[int] = ..., proof: _Optional[str] = ...) -> None: ...

class Promise(_message.Message):
    __slots__ = ("output", "input", "cost", "seconds")
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    INPUT_FIELD_NUMBER: _ClassVar[int]
    COST_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    output: _containers.RepeatedScalarFieldContainer[float]
    input: _containers.RepeatedScalarFieldContainer[float]
    cost: float
    seconds: float
    def __init__(self, output: _Optional[_Iterable[float]] = ..., input: _Optional[_Iterable[float]] = ..., cost: _Optional[float] = ..., seconds: _Optional[float] = ...) -> None: ...

class Receipt(_message.Message):
    __slots__ = ("machine", "ranges")
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    RANGES_FIELD_NUMBER: _ClassVar[int]
    machine: str
    ranges: _containers.RepeatedCompositeFieldContainer[SampleRange]
    def __init__(self, machine: _Optional[str] = ..., ranges: _Optional[_Iterable[_Union[SampleRange, _Mapping]]] = ...) -> None: ...

class SampleRange(_message.Message):
    __slots__ = ("session", "start", "end")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    END_FIELD_NUMBER: _ClassVar[int]
    session: str
    start: int
    end: int
    def __init__(self, session: _Optional[str] = ..., start: _Optional[int] = ..., end: _Optional[int] = ...) -> None: ...

class RigEvent(_message.Message):
    __slots__ = ("timestamp", "machine", "session", "kind", "burst", "cause", "k")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNSPECIFIED: _ClassVar[RigEvent.Kind]
        RIG_STARTED: _ClassVar[RigEvent.Kind]
        RIG_STOPPED: _ClassVar[RigEvent.Kind]
        BURST_STARTED: _ClassVar[RigEvent.Kind]
        BURST_ENDED: _ClassVar[RigEvent.Kind]
        BURST_ABORTED: _ClassVar[RigEvent.Kind]
        BURST_REFUSED: _ClassVar[RigEvent.Kind]
        FAULT_INJECTED: _ClassVar[RigEvent.Kind]
        NOTE: _ClassVar[RigEvent.Kind]
        RETUNED: _ClassVar[RigEvent.Kind]
        RESTORED: _ClassVar[RigEvent.Kind]
        RETUNE_REFUSED: _ClassVar[RigEvent.Kind]
    UNSPECIFIED: RigEvent.Kind
    RIG_STARTED: RigEvent.Kind
    RIG_STOPPED: RigEvent.Kind
    BURST_STARTED: RigEvent.Kind
    BURST_ENDED: RigEvent.Kind
    BURST_ABORTED: RigEvent.Kind
    BURST_REFUSED: RigEvent.Kind
    FAULT_INJECTED: RigEvent.Kind
    NOTE: RigEvent.Kind
    RETUNED: RigEvent.Kind
    RESTORED: RigEvent.Kind
    RETUNE_REFUSED: RigEvent.Kind
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    session: str
    kind: RigEvent.Kind
    burst: str
    cause: str
    k: int
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., session: _Optional[str] = ..., kind: _Optional[_Union[RigEvent.Kind, str]] = ..., burst: _Optional[str] = ..., cause: _Optional[str] = ..., k: _Optional[int] = ...) -> None: ...

class ChannelInfo(_message.Message):
    __slots__ = ("name", "unit")
    NAME_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    name: str
    unit: str
    def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ...) -> None: ...

class Limits(_message.Message):
    __slots__ = ("output", "input", "alpha", "seconds")
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    INPUT_FIELD_NUMBER: _ClassVar[int]
    ALPHA_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    output: _containers.RepeatedScalarFieldContainer[float]
    input: _containers.RepeatedScalarFieldContainer[float]
    alpha: _containers.RepeatedScalarFieldContainer[float]
    seconds: float
    def __init__(self, output: _Optional[_Iterable[float]] = ..., input: _Optional[_Iterable[float]] = ..., alpha: _Optional[_Iterable[float]] = ..., seconds: _Optional[float] = ...) -> None: ...

class RigDescription(_message.Message):
    __slots__ = ("timestamp", "machine", "session", "dt", "channels", "limits", "controller", "site", "model", "version", "driver", "samples", "late", "head_room")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    DT_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    CONTROLLER_FIELD_NUMBER: _ClassVar[int]
    SITE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    DRIVER_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    HEAD_ROOM_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    session: str
    dt: float
    channels: _containers.RepeatedCompositeFieldContainer[ChannelInfo]
    limits: Limits
    controller: str
    site: str
    model: str
    version: str
    driver: str
    samples: int
    late: int
    head_room: float
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., session: _Optional[str] = ..., dt: _Optional[float] = ..., channels: _Optional[_Iterable[_Union[ChannelInfo, _Mapping]]] = ..., limits: _Optional[_Union[Limits, _Mapping]] = ..., controller: _Optional[str] = ..., site: _Optional[str] = ..., model: _Optional[str] = ..., version: _Optional[str] = ..., driver: _Optional[str] = ..., samples: _Optional[int] = ..., late: _Optional[int] = ..., head_room: _Optional[float] = ...) -> None: ...

class NamedValue(_message.Message):
    __slots__ = ("name", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...

class Severity(_message.Message):
    __slots__ = ("value", "sd", "low", "high")
    VALUE_FIELD_NUMBER: _ClassVar[int]
    SD_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    value: float
    sd: float
    low: float
    high: float
    def __init__(self, value: _Optional[float] = ..., sd: _Optional[float] = ..., low: _Optional[float] = ..., high: _Optional[float] = ...) -> None: ...

class Evidence(_message.Message):
    __slots__ = ("timestamp", "machine", "session", "detector", "k", "seconds", "statistic", "threshold", "detected", "burst", "output", "fault", "severity", "weights", "trustworthy", "reason", "p_white", "parts")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    DETECTOR_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    STATISTIC_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_FIELD_NUMBER: _ClassVar[int]
    DETECTED_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    TRUSTWORTHY_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    P_WHITE_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    machine: str
    session: str
    detector: str
    k: int
    seconds: float
    statistic: float
    threshold: float
    detected: bool
    burst: str
    output: str
    fault: str
    severity: Severity
    weights: _containers.RepeatedCompositeFieldContainer[NamedValue]
    trustworthy: bool
    reason: str
    p_white: float
    parts: _containers.RepeatedCompositeFieldContainer[NamedValue]
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., machine: _Optional[str] = ..., session: _Optional[str] = ..., detector: _Optional[str] = ..., k: _Optional[int] = ..., seconds: _Optional[float] = ..., statistic: _Optional[float] = ..., threshold: _Optional[float] = ..., detected: _Optional[bool] = ..., burst: _Optional[str] = ..., output: _Optional[str] = ..., fault: _Optional[str] = ..., severity: _Optional[_Union[Severity, _Mapping]] = ..., weights: _Optional[_Iterable[_Union[NamedValue, _Mapping]]] = ..., trustworthy: _Optional[bool] = ..., reason: _Optional[str] = ..., p_white: _Optional[float] = ..., parts: _Optional[_Iterable[_Union[NamedValue, _Mapping]]] = ...) -> None: ...

class Alarm(_message.Message):
    __slots__ = ("id", "machine", "fault", "severity", "since", "last", "count", "active", "acknowledged", "acknowledged_by", "comment", "kind", "confirmed", "confirmed_by", "latched", "shelved_until", "shelved_by", "suppressed", "cause", "ended", "sentence", "raised_by")
    ID_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    SINCE_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_BY_FIELD_NUMBER: _ClassVar[int]
    COMMENT_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    CONFIRMED_FIELD_NUMBER: _ClassVar[int]
    CONFIRMED_BY_FIELD_NUMBER: _ClassVar[int]
    LATCHED_FIELD_NUMBER: _ClassVar[int]
    SHELVED_UNTIL_FIELD_NUMBER: _ClassVar[int]
    SHELVED_BY_FIELD_NUMBER: _ClassVar[int]
    SUPPRESSED_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    RAISED_BY_FIELD_NUMBER: _ClassVar[int]
    id: str
    machine: str
    fault: str
    severity: Severity
    since: _timestamp_pb2.Timestamp
    last: _timestamp_pb2.Timestamp
    count: int
    active: bool
    acknowledged: bool
    acknowledged_by: str
    comment: str
    kind: str
    confirmed: bool
    confirmed_by: str
    latched: bool
    shelved_until: _timestamp_pb2.Timestamp
    shelved_by: str
    suppressed: str
    cause: str
    ended: _timestamp_pb2.Timestamp
    sentence: str
    raised_by: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, id: _Optional[str] = ..., machine: _Optional[str] = ..., fault: _Optional[str] = ..., severity: _Optional[_Union[Severity, _Mapping]] = ..., since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., last: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., count: _Optional[int] = ..., active: _Optional[bool] = ..., acknowledged: _Optional[bool] = ..., acknowledged_by: _Optional[str] = ..., comment: _Optional[str] = ..., kind: _Optional[str] = ..., confirmed: _Optional[bool] = ..., confirmed_by: _Optional[str] = ..., latched: _Optional[bool] = ..., shelved_until: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., shelved_by: _Optional[str] = ..., suppressed: _Optional[str] = ..., cause: _Optional[str] = ..., ended: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., sentence: _Optional[str] = ..., raised_by: _Optional[_Iterable[str]] = ...) -> None: ...

class AlarmChange(_message.Message):
    __slots__ = ("timestamp", "alarm", "event", "who", "why")
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    ALARM_FIELD_NUMBER: _ClassVar[int]
    EVENT_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    WHY_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    alarm: Alarm
    event: str
    who: str
    why: str
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., alarm: _Optional[_Union[Alarm, _Mapping]] = ..., event: _Optional[str] = ..., who: _Optional[str] = ..., why: _Optional[str] = ...) -> None: ...

class MachineStatus(_message.Message):
    __slots__ = ("machine", "session", "state", "reason", "blocks", "lost_blocks", "late", "head_room", "block_age", "burst", "next_burst", "trustworthy", "alarms", "tuning")
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    BLOCKS_FIELD_NUMBER: _ClassVar[int]
    LOST_BLOCKS_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    HEAD_ROOM_FIELD_NUMBER: _ClassVar[int]
    BLOCK_AGE_FIELD_NUMBER: _ClassVar[int]
    BURST_FIELD_NUMBER: _ClassVar[int]
    NEXT_BURST_FIELD_NUMBER: _ClassVar[int]
    TRUSTWORTHY_FIELD_NUMBER: _ClassVar[int]
    ALARMS_FIELD_NUMBER: _ClassVar[int]
    TUNING_FIELD_NUMBER: _ClassVar[int]
    machine: str
    session: str
    state: str
    reason: str
    blocks: int
    lost_blocks: int
    late: int
    head_room: float
    block_age: float
    burst: str
    next_burst: float
    trustworthy: bool
    alarms: _containers.RepeatedCompositeFieldContainer[Alarm]
    tuning: str
    def __init__(self, machine: _Optional[str] = ..., session: _Optional[str] = ..., state: _Optional[str] = ..., reason: _Optional[str] = ..., blocks: _Optional[int] = ..., lost_blocks: _Optional[int] = ..., late: _Optional[int] = ..., head_room: _Optional[float] = ..., block_age: _Optional[float] = ..., burst: _Optional[str] = ..., next_burst: _Optional[float] = ..., trustworthy: _Optional[bool] = ..., alarms: _Optional[_Iterable[_Union[Alarm, _Mapping]]] = ..., tuning: _Optional[str] = ...) -> None: ...

class ServiceStatus(_message.Message):
    __slots__ = ("timestamp", "site", "version", "uptime", "machines", "recording", "recording_bytes", "recording_failure", "recording_dropped", "longest_waits")
    class LongestWaitsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    SITE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    UPTIME_FIELD_NUMBER: _ClassVar[int]
    MACHINES_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    RECORDING_BYTES_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FAILURE_FIELD_NUMBER: _ClassVar[int]
    RECORDING_DROPPED_FIELD_NUMBER: _ClassVar[int]
    LONGEST_WAITS_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    site: str
    version: str
    uptime: float
    machines: _containers.RepeatedCompositeFieldContainer[MachineStatus]
    recording: str
    recording_bytes: int
    recording_failure: str
    recording_dropped: int
    longest_waits: _containers.ScalarMap[str, float]
    def __init__(self, timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., site: _Optional[str] = ..., version: _Optional[str] = ..., uptime: _Optional[float] = ..., machines: _Optional[_Iterable[_Union[MachineStatus, _Mapping]]] = ..., recording: _Optional[str] = ..., recording_bytes: _Optional[int] = ..., recording_failure: _Optional[str] = ..., recording_dropped: _Optional[int] = ..., longest_waits: _Optional[_Mapping[str, float]] = ...) -> None: ...

class Command(_message.Message):
    __slots__ = ("name", "arguments", "asked_by", "timestamp", "nonce")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ARGUMENTS_FIELD_NUMBER: _ClassVar[int]
    ASKED_BY_FIELD_NUMBER: _ClassVar[int]
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    NONCE_FIELD_NUMBER: _ClassVar[int]
    name: str
    arguments: str
    asked_by: str
    timestamp: _timestamp_pb2.Timestamp
    nonce: str
    def __init__(self, name: _Optional[str] = ..., arguments: _Optional[str] = ..., asked_by: _Optional[str] = ..., timestamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., nonce: _Optional[str] = ...) -> None: ...

class CommandReply(_message.Message):
    __slots__ = ("ok", "error", "result")
    OK_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    ok: bool
    error: str
    result: str
    def __init__(self, ok: _Optional[bool] = ..., error: _Optional[str] = ..., result: _Optional[str] = ...) -> None: ...
