"""Everything said beside samples comes back as it was said, and nothing but `BadInput` comes of bad bytes."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.evidence import Evidence, Severity
from afdsvc.api.retuning import DiagnosedFault, Promise, Tuning
from afdsvc.api.signals import Channel
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import StateSpace
from afdsvc.wire import afdsvc_pb2 as pb
from afdsvc.wire import codec
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
    RetuneRequest,
    RigDescription,
    RigEvent,
    ServiceStatus,
)

T = 1_763_000_000_000_000_001
SINES = Burst(
    "b1",
    2,
    1000,
    50,
    (Line(0, 640.0, 0.1), Line(1, 641.0, 0.2, 0.3)),
    settle=10,
    purpose="identify",
    notes={"z": "1", "a": "2"},
)
WAVE = Burst("w", 2, 3, 1, waveform=np.array([[0.1, -0.0], [np.pi, 1e-300], [3.0, 4.0]]))
EVIDENCE = Evidence(
    "matched_filter",
    "m1",
    12345,
    2.469,
    41.7,
    9.2,
    True,
    "b1",
    "y_x",
    "horizontal_actuator",
    Severity(-0.5, 0.02),
    {"z_last": 0.9, "a_first": 0.1},
    True,
    "",
    0.4,
    {"amplitude": 1 / 3, "phase": float("nan")},
)
SHELVED = Alarm(
    "a2", "m1", "frozen_sensor", T, T, kind=AlarmKind.SYSTEM, confirmed=True, confirmed_by="kim", latched=True, shelved_until_ns=T + 9,
    shelved_by="lee", suppressed="consequence of a1", cause="a1", ended_ns=T + 7, sentence="stands still", raised_by=("regression", "cusum"),
)
Q = StateSpace(np.array([[0.5, 1 / 3, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, -0.2]]), np.ones((3, 2)) / 7, np.arange(3.0)[None, :], np.array([[0.1, -0.0]]), 2e-4)
ALARM = Alarm("a1", "m1", "horizontal_actuator", T, T + 5, 3, True, Severity(-0.5, 0.1), True, "kim", "seen")
MACHINE = MachineStatus("m1", "stale", "s1", "no block for 3 s", 10, 1, 2, 0.7, 3.0, "b1", 12.5, False, (ALARM, SHELVED), "Q acts")

MESSAGES = {
    "burst_request": BurstRequest("m1", SINES, 2.0, "scheduler", T),
    "burst_reply": BurstReply(False, "b1", "already playing"),
    "burst_stop": BurstStop("m1", "asked to", "kim", "b1"),
    "retune_request": RetuneRequest(
        "m1", "q1", Tuning(Q, 0.0, 0.01, Promise(np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([[3.0]]), 4.5, 2.0)), DiagnosedFault("horizontal_actuator", -0.6, -0.5),
        2.0, "kim", T, "s1", 77, "stable",
    ),
    "lease": Lease("m1", "b1", 2.0),
    "receipt": Receipt("m1", (("s0", 5, 9), ("s1", 0, 2**40))),
    "event": RigEvent("m1", "s1", T, EventKind.BURST_ABORTED, 77, "b1", "an output reached its limit"),
    "description": RigDescription(
        "m1",
        "s1",
        T,
        2e-4,
        (Channel("u_x", "V"), Channel("y_x", "um")),
        Limits(np.array([10.0]), np.array([np.inf]), np.array([0.5]), 14.0),
        "observer with LQR",
        "[site]",
        "A=1",
        "0.1",
        "sim",
    ),
    "finding": Finding(EVIDENCE, "s1", T),
    "status": ServiceStatus(
        "plant", "0.1", T, 3.5, (MACHINE, MachineStatus("m2", "running")), "r.mcap", 5, "disk full", 6
    ),
    "alarm_change": AlarmChange(SHELVED, "shelved", T, "lee", "cleaning"),
    "command": Command("ack", {"alarm": "a1", "n": [1, 2.5, None]}, "kim"),
    "command_reply": CommandReply(True, {"machines": [{"id": "m1"}]}),
}


def plain(value):
    """Return nested tuples of bytes and values that compare equal exactly when the messages are."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return type(value), tuple(plain(getattr(value, f.name)) for f in dataclasses.fields(value))
    if isinstance(value, dict):
        return tuple((k, plain(v)) for k, v in value.items())
    if isinstance(value, (tuple, list)):
        return tuple(map(plain, value))
    return np.float64(value).tobytes() if isinstance(value, float) else value


def through(kind, message):
    return codec.decode(type(MESSAGES[kind]), codec.encode(message))


@pytest.mark.parametrize(("kind", "message"), MESSAGES.items())
def test_comes_back_as_it_was(kind, message):
    back = through(kind, message)
    if kind == "burst_request":  # notes are a map: their order is not kept
        assert dict(back.burst.notes) == dict(message.burst.notes)
        back, message = (dataclasses.replace(m, burst=dataclasses.replace(m.burst, notes={})) for m in (back, message))
    assert plain(back) == plain(message)


@pytest.mark.parametrize(("kind", "message"), MESSAGES.items())
def test_the_same_value_gives_the_same_bytes(kind, message):
    assert codec.encode(message) == codec.encode(through(kind, message))


def test_a_waveform_survives_to_the_last_bit():
    request = BurstRequest("m1", WAVE, 1.0, "kim", T)
    back = through("burst_request", request)
    assert plain(back.burst) == plain(WAVE)


def test_optional_parts_of_evidence_stay_absent():
    bare = Evidence("cusum", "m1", 1, 0.1, 1.0, 2.0, False)
    back = through("finding", Finding(bare, "s1", T)).evidence
    assert (back.fault, back.severity, back.p_white) == (None, None, None)
    named_empty = dataclasses.replace(bare, fault="", p_white=0.0)
    back = through("finding", Finding(named_empty, "s1", T)).evidence
    assert (back.fault, back.p_white) == ("", 0.0)


@settings(deadline=None)
@given(
    st.floats(),
    st.floats(),
    st.floats(),
    st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), st.floats()),
)
def test_numbers_of_evidence_are_exact(statistic, threshold, sd, weights):
    e = dataclasses.replace(
        EVIDENCE, statistic=statistic, threshold=threshold, severity=Severity(-0.1, sd), weights=weights
    )
    assert plain(through("finding", Finding(e, "s1", T))) == plain(Finding(e, "s1", T))


def message_of(kind, **changes):
    message = codec.RULES[type(MESSAGES[kind])].message.FromString(codec.encode(MESSAGES[kind]))
    for change in changes.values():
        change(message)
    return message.SerializeToString()


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("burst_request", lambda m: m.ClearField("burst"), "without burst"),
        ("burst_request", lambda m: m.ClearField("asked_by"), "without asked_by"),
        ("burst_request", lambda m: m.ClearField("lease"), "lease = 0.0"),
        ("burst_request", lambda m: m.burst.ClearField("name"), "without name"),
        ("burst_request", lambda m: setattr(m.burst.lines[0], "amplitude", float("nan")), "NaN"),
        ("burst_request", lambda m: setattr(m.burst.lines[0], "input", 2), "line on input 2"),
        ("burst_request", lambda m: setattr(m.burst, "ramp", 501), "two ramps"),
        ("burst_request", lambda m: m.burst.waveform.add(values=[1.0]), "waveform columns of [1]"),
        ("burst_reply", lambda m: m.ClearField("reason"), "without reason"),
        ("burst_stop", lambda m: m.ClearField("asked_by"), "without asked_by"),
        ("retune_request", lambda m: m.matrices.append(1.0), "with 21 numbers; expected 20"),
        ("retune_request", lambda m: setattr(m, "states", 2**40), "numbers; expected"),
        ("retune_request", lambda m: m.matrices.__setitem__(0, float("nan")), "NaN"),
        ("retune_request", lambda m: setattr(m, "rise", -1.0), "times -1.0"),
        ("retune_request", lambda m: setattr(m, "low", 0.0), "expected the larger loss first"),
        ("retune_request", lambda m: m.promise.output.append(1.0), "weights of 5 and 1"),
        ("retune_request", lambda m: m.ClearField("asked_by"), "without asked_by"),
        ("lease", lambda m: setattr(m, "seconds", float("inf")), "seconds = inf"),
        ("event", lambda m: setattr(m, "kind", 0), "kind 0"),
        ("event", lambda m: setattr(m, "kind", 99), "kind 99"),
        ("event", lambda m: setattr(m, "machine", "a*b"), "'*'"),
        ("description", lambda m: setattr(m.channels[0], "name", "x"), "'x' has no role"),
        ("description", lambda m: m.ClearField("channels"), "without channels"),
        ("description", lambda m: m.limits.output.append(-1.0), "negative or NaN"),
        ("description", lambda m: m.limits.output.append(float("nan")), "negative or NaN"),
        ("finding", lambda m: m.ClearField("detector"), "without detector"),
        ("finding", lambda m: m.ClearField("trustworthy"), "without reason"),
        ("finding", lambda m: m.weights.add(name="z_last"), "'z_last' is given twice"),
        ("status", lambda m: m.ClearField("site"), "without site"),
        ("status", lambda m: m.machines[0].ClearField("state"), "without state"),
        ("status", lambda m: m.machines[0].alarms[0].ClearField("since"), "without since"),
        ("command", lambda m: m.ClearField("name"), "without name"),
        ("command", lambda m: setattr(m, "arguments", "[1]"), "expected a JSON object"),
        ("command", lambda m: setattr(m, "arguments", "{"), "is not JSON"),
        ("command", lambda m: setattr(m, "arguments", "[" * 100_000), "is not JSON"),
        ("command_reply", lambda m: setattr(m, "ok", False), "without error"),
    ],
)
def test_what_is_wrong_is_named(kind, change, words):
    with pytest.raises(BadInput, match=words.replace("[", r"\[").replace("*", r"\*")):
        codec.decode(type(MESSAGES[kind]), message_of(kind, change=change))


def test_json_cannot_say_nan():
    with pytest.raises(BadInput, match="JSON"):
        codec.encode(CommandReply(True, {"p": float("nan")}))


@settings(deadline=None, max_examples=50)
@pytest.mark.parametrize("kind", MESSAGES)
@given(data=st.data())
def test_any_damage_decodes_or_raises_bad_input(kind, data):
    raw = bytearray(codec.encode(MESSAGES[kind]))
    for _ in range(data.draw(st.integers(0, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raw = data.draw(st.one_of(st.just(bytes(raw)), st.binary(max_size=80), st.just(bytes(raw[: len(raw) // 2]))))
    try:
        decoded = codec.decode(type(MESSAGES[kind]), raw)
    except BadInput:
        return
    assert isinstance(decoded, type(MESSAGES[kind]))


def test_every_message_is_tested():
    nested = {Alarm, Burst, Channel, Limits, Line, MachineStatus, Promise, Severity}
    assert codec.RULES.keys() == nested | {type(message) for message in MESSAGES.values()}


def test_every_attribute_travels():
    """A field added to a class and not to its message, or the other way round, fails."""
    for kind, message in MESSAGES.items():
        found = codec.RULES[type(message)]
        fields = {codec._attribute(f) for f in found.message.DESCRIPTOR.fields}
        lost = {f.name for f in dataclasses.fields(message)} - fields - {"evidence", "tuning", "found"}
        assert not lost, kind


def test_every_event_kind_has_a_number():
    assert set(pb.RigEvent.Kind.keys()) == {"UNSPECIFIED", *EventKind.__members__}
