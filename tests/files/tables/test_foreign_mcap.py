"""MCAP files of others, written by the libraries others write them with: protobuf, JSON with and without schema, ROS 2."""

import json
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.message_factory import GetMessageClass
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter

from afdsvc.app.init import Answers, init_files
from afdsvc.errors import BadInput
from afdsvc.files.open import Naming, open_file
from afdsvc.files.recording.foxglove import pool_of
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.tables.foreign_mcap import number, numeric_paths, shown, stamp_ns
from afdsvc.files.tables.mapping import DataMapping

T0 = 1_763_000_000_123_456_789
DT_NS, N = 1_000_000, 400
LATE_NS = 250_000  # from stamp to log
U = np.sin(2 * np.pi * 3 * np.arange(N) / 1000)
Y = np.random.default_rng(0).standard_normal(N)


def read_foreign(path, mapping, model=None):
    return open_file(path, Naming(mapping)).traces(model)


def mapping(**signals) -> DataMapping:
    """Return a mapping of signals; ``time`` and ``resample`` are its other sections."""
    sections = {key: signals.pop(key) for key in ("time", "resample") if key in signals}
    return DataMapping.model_validate({"signals": signals, **sections})


def drive_message():
    """Return a message class as a drive's maker would define it: nested fields, an array, an enum, and a time stamp."""
    F = FieldDescriptorProto
    file = FileDescriptorProto(name="drive.proto", package="maker", dependency=["google/protobuf/timestamp.proto"], syntax="proto3")
    state = file.message_type.add(name="State")
    state.field.add(name="current", number=1, label=F.LABEL_REPEATED, type=F.TYPE_FLOAT)
    state.field.add(name="ok", number=2, label=F.LABEL_OPTIONAL, type=F.TYPE_BOOL)
    drive = file.message_type.add(name="Drive")
    drive.field.add(name="timestamp", number=1, label=F.LABEL_OPTIONAL, type=F.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    drive.field.add(name="state", number=2, label=F.LABEL_OPTIONAL, type=F.TYPE_MESSAGE, type_name=".maker.State")
    drive.field.add(name="label", number=3, label=F.LABEL_OPTIONAL, type=F.TYPE_STRING)
    drive.field.add(name="ticks", number=4, label=F.LABEL_OPTIONAL, type=F.TYPE_SINT64)
    return GetMessageClass(pool_of(file).FindMessageTypeByName("maker.Drive"))


def write_protobuf(path, stamped: bool = True):
    Drive = drive_message()
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for k in range(N):
            t = T0 + k * DT_NS
            message = Drive(label="x", ticks=k)
            message.state.current.extend([0.0, U[k]])
            if stamped:
                message.timestamp.seconds, message.timestamp.nanos = divmod(t, 10**9)
            writer.write_message("/drive/state", message, log_time=t + LATE_NS, publish_time=t)
    return path


def write_json(path, schema: bool, stamps=None, values=U, topic="encoder", chunk=1 << 20):
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk)
        writer.start()
        described = writer.register_schema("Encoder", "jsonschema", b'{"type": "object"}') if schema else 0
        channel = writer.register_channel(topic, "json", described)
        writer.add_message(writer.register_channel("camera.front", "json", 0), T0, b'{"name": "not wanted"}', T0)
        for k in range(N):
            t = T0 + k * DT_NS
            body = {"angle": {"deg": [values[k]]}, "name": "e1", "us": k * 1000}
            if stamps:
                body[stamps] = {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}} if stamps == "header" else {"sec": t // 10**9, "nsec": t % 10**9}
            writer.add_message(channel, t + LATE_NS, json.dumps(body).encode(), t)
        writer.finish()
    return path


IMU = """std_msgs/Header header
geometry_msgs/Vector3 angular_velocity
float64[3] bias
string frame
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def write_ros2(path):
    writer_of = pytest.importorskip("mcap_ros2.writer", reason="the extra 'ros' is not installed")
    with path.open("wb") as file:
        writer = writer_of.Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
        for k in range(N):
            t = T0 + k * DT_NS
            header = {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": "base"}
            message = {"header": header, "angular_velocity": {"x": 0.0, "y": Y[k], "z": U[k]}, "bias": [0.0, 0.5, 0.0], "frame": "f"}
            writer.write_message("/imu", schema, message, t + LATE_NS, t)
        writer.finish()
    return path


def test_a_protobuf_topic_by_its_fields(tmp_path):
    path = write_protobuf(tmp_path / "drive.mcap")
    reported = {"from": "/drive/state.state.current[1]", "unit": "A"}
    (trace,) = read_foreign(path, mapping(u_current=reported, aux_ticks="/drive/state.ticks"))
    assert trace.column("u_current").tobytes() == U.astype(np.float32).astype(float).tobytes()
    np.testing.assert_array_equal(trace.column("aux_ticks"), np.arange(N))
    assert (trace.dt, trace.t0) == (1e-3, 0.0)
    assert prepared([trace]) == [
        "drive.mcap: the time of a sample is the stamp in its message",
        "drive.mcap: u_current is /drive/state.state.current[1] [A]",
        "drive.mcap: aux_ticks is /drive/state.ticks, its unit unknown",
    ]


def test_without_stamps_the_time_is_the_logs_and_that_is_reported(tmp_path):
    path = write_protobuf(tmp_path / "drive.mcap", stamped=False)
    wanted = {"u_current": "/drive/state.state.current[1]"}
    (trace,) = read_foreign(path, mapping(**wanted))
    assert prepared([trace])[0].endswith("messages of '/drive/state' carry no stamp: the time of a sample is when its message was logged")
    with pytest.raises(BadInput, match="messages of '/drive/state' carry no stamp"):
        read_foreign(path, mapping(**wanted, time={"from": "header"}))


@pytest.mark.parametrize("schema", [True, False])
def test_a_json_topic_with_and_without_schema(schema, tmp_path):
    path = write_json(tmp_path / "encoder.mcap", schema)
    (trace,) = read_foreign(path, mapping(y_angle={"from": "encoder.angle.deg[0]", "unit": "deg", "to": "rad"}))
    np.testing.assert_allclose(trace.column("y_angle"), U * np.pi / 180, rtol=1e-14)


@pytest.mark.parametrize("stamps", ["header", "stamp", "timestamp"])
def test_stamps_of_all_spellings_are_found(stamps, tmp_path):
    (trace,) = read_foreign(write_json(tmp_path / "e.mcap", False, stamps), mapping(y_angle="encoder.angle.deg[0]"))
    assert "the stamp in its message" in prepared([trace])[0]


@pytest.mark.parametrize(("time", "said"), [("log", "was logged"), ("publish", "was published")])
def test_the_time_that_was_asked_for_is_taken(time, said, tmp_path):
    (trace,) = read_foreign(write_json(tmp_path / "e.mcap", False, "header"), mapping(y_angle="encoder.angle.deg[0]", time={"from": time}))
    assert said in prepared([trace])[0]


def test_log_and_publish_times_are_two_and_the_longest_topic_is_meant(tmp_path):
    """The log comes late by up to 0.4 ms, publishing does not; "/a.b" is a topic beside "/a", whose messages have a field b too."""
    rng = np.random.default_rng(0)
    with (tmp_path / "two.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        short, long = (writer.register_channel(name, "json", 0) for name in ("/a", "/a.b"))
        for k in range(N):
            t = T0 + k * DT_NS
            writer.add_message(short, t, b'{"b": {"v": -1.0}}', t)
            writer.add_message(long, t + int(rng.integers(400_000)), json.dumps({"v": U[k]}).encode(), t)
        writer.finish()
    (trace,) = read_foreign(tmp_path / "two.mcap", mapping(y_x="/a.b.v", time={"from": "publish"}))
    np.testing.assert_array_equal(trace.column("y_x"), U)
    assert not any("miss an even grid" in s for s in prepared([trace]))
    (trace,) = read_foreign(tmp_path / "two.mcap", mapping(y_x="/a.b.v", time={"from": "log"}))
    assert any("the times of /a.b miss an even grid of 0.001 s by up to" in s for s in prepared([trace]))


def test_a_field_can_be_the_time_in_its_own_unit(tmp_path):
    wanted = mapping(y_angle="encoder.angle.deg[0]", time={"from": "us", "unit": "us"})
    (trace,) = read_foreign(write_json(tmp_path / "e.mcap", False), wanted)
    assert trace.dt == pytest.approx(1e-3)
    assert prepared([trace])[0] == "e.mcap: the time of a sample is field us [us] of its message"


def test_a_ros2_topic_by_its_fields(tmp_path):
    path = write_ros2(tmp_path / "imu.mcap")
    (trace,) = read_foreign(path, mapping(y_rate="/imu.angular_velocity.y", u_drive="/imu.angular_velocity.z", aux_bias="/imu.bias[1]"))
    assert [c.name for c in trace.channels] == ["u_drive", "y_rate", "aux_bias"]
    assert trace.column("y_rate").tobytes() == Y.tobytes()
    np.testing.assert_array_equal(trace.column("aux_bias"), 0.5)
    assert "the stamp in its message" in prepared([trace])[0]


def test_two_topics_meet_on_one_grid(tmp_path):
    path = tmp_path / "two.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        fast, slow = (writer.register_channel(name, "json", 0) for name in ("/u", "/y"))
        for k in range(6000):
            t = k * 1e-3
            writer.add_message(fast, T0 + k * DT_NS, json.dumps({"v": np.sin(20 * t)}).encode(), 0)
            if k % 4 == 0:
                writer.add_message(slow, T0 + k * DT_NS + 300_000, json.dumps({"v": np.cos(20 * (t + 3e-4))}).encode(), 0)
        writer.finish()
    (trace,) = read_foreign(path, mapping(u_x="/u.v", y_x="/y.v"))
    assert trace.dt == 4e-3
    assert np.abs(trace.column("u_x") - np.sin(20 * trace.t)).max() < 3e-4
    assert np.abs(trace.column("y_x") - np.cos(20 * trace.t)).max() < 3e-4
    assert "resampled from 1000 Hz (/u), 250 Hz (/y) to 250 Hz" in prepared([trace])[-1]
    document = init_files(path, answers=Answers(inputs=["/u.v"], outputs=["/y.v"]))
    (again,) = open_file(path, Naming.of(Path(document["mapping"]))).traces()
    np.testing.assert_array_equal(again.values, trace.values)
    with pytest.raises(BadInput, match=r"no column name says that it is an input, .*; expected --input COLUMN, one of /u\.v, /y\.v"):
        init_files(path, tmp_path / "other")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("/motor.v", r"no topic for '/motor\.v', which is to be y_x; expected TOPIC\.FIELD, and it has camera\.front \(json\), encoder \(Encoder\)"),
        ("encoder", "no topic for 'encoder'"),
        ("encoder.angle.rad", r"encoder\.angle\.rad: has no such field; expected a number, and it has angle\.deg\[0\], us"),
        ("encoder.name", r"encoder\.name: holds str there; expected a number"),
        ("encoder.angle", r"encoder\.angle: holds dict there"),
        ("encoder.angle.deg[4]", r"deg\[4\]: has no such field"),
        ("camera.front.x", r"camera\.front\.x: has no such field; expected a number, and it has none"),
    ],
)
def test_what_is_not_there_is_refused_with_what_is(place, said, tmp_path):
    with pytest.raises(BadInput, match=said):
        read_foreign(write_json(tmp_path / "e.mcap", True), mapping(y_x=place))


def test_messages_nobody_can_decode_are_refused(tmp_path):
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, encoding, schema in (("/a", "cbor", 0), ("/b", "protobuf", 0), ("/c", "json", 0), ("/d", "cdr", 0)):
            writer.add_message(writer.register_channel(topic, encoding, schema), T0, b"{", T0)
        broken = writer.register_schema("X", "protobuf", b"\xff\xff")
        writer.add_message(writer.register_channel("/e", "protobuf", broken), T0, b"{", T0)
        writer.register_channel("/f", "json", 0)
        writer.finish()
    with pytest.raises(BadInput, match="topic '/a': messages are encoded as 'cbor'; expected protobuf, json or cdr"):
        read_foreign(path, mapping(y_x="/a.v"))
    with pytest.raises(BadInput, match="topic '/b': its schema is none"):
        read_foreign(path, mapping(y_x="/b.v"))
    with pytest.raises(BadInput, match="a message of '/c' cannot be decoded: JSONDecodeError"):
        read_foreign(path, mapping(y_x="/c.v"))
    with pytest.raises(BadInput, match=r"topic '/d': (its schema is none|is a ROS 2 topic, which needs the extra 'ros')"):
        read_foreign(path, mapping(y_x="/d.v"))
    with pytest.raises(BadInput, match="topic '/e': its schema cannot be read"):
        read_foreign(path, mapping(y_x="/e.v"))
    with pytest.raises(BadInput, match="topic '/f' has no messages"):
        read_foreign(path, mapping(y_x="/f.v"))


def test_ros2_without_the_extra_names_it(tmp_path, monkeypatch):
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/d", "cdr", writer.register_schema("X", "ros2msg", b"float64 v")), T0, bytes(12), T0)
        writer.finish()
    monkeypatch.setitem(__import__("sys").modules, "mcap_ros2.decoder", None)
    with pytest.raises(BadInput, match=r"topic '/d': is a ROS 2 topic, which needs the extra 'ros': install afdsvc\[ros\]"):
        read_foreign(path, mapping(y_x="/d.v"))


def test_a_torn_file_gives_what_is_complete_and_says_so(tmp_path):
    whole = write_json(tmp_path / "e.mcap", True, chunk=2000).read_bytes()
    (tmp_path / "torn.mcap").write_bytes(whole[: len(whole) // 2])
    (trace,) = read_foreign(tmp_path / "torn.mcap", mapping(y_x="encoder.angle.deg[0]"))
    assert 50 < len(trace) < N - 50
    np.testing.assert_array_equal(trace.column("y_x"), U[: len(trace)])
    assert any("not all could be read: the last" in s for s in prepared([trace]))


def test_a_recording_that_is_not_ours_asks_for_a_mapping(tmp_path):
    path = write_json(tmp_path / "e.mcap", True)
    with pytest.raises(BadInput, match=r"holds no samples of afdsvc; expected a mapping file \(--mapping FILE\.toml\) .*; it has encoder\.angle\.deg\[0\], encoder\.us$"):
        open_file(path, Naming()).traces()
    (trace,) = open_file(path, Naming(None, {"encoder.angle.deg[0]": "y_angle"})).traces()
    assert len(trace) == N


def test_no_more_places_are_listed_than_can_be_read():
    places = [f"motor.{k}" for k in range(30)]
    assert shown(places).endswith("motor.23 and 6 more")
    assert shown(places[:2]) == "motor.0, motor.1"
    assert shown([]) == "no messages"


def test_paths_and_stamps_of_odd_messages():
    assert list(numeric_paths({"a": {"b": [1, True]}, "c": "text", "d": None})) == ["a.b[0]", "a.b[1]"]
    assert stamp_ns({"header": {"stamp": {"sec": 3, "nsec": 5}}}) == 3_000_000_005
    assert stamp_ns({"header": {"stamp": {"sec": 0, "nanosec": 0}}}) is None
    assert stamp_ns({"stamp": 3}) is None
    assert stamp_ns([1, 2]) is None
    for odd in ("abc", 1e300, float("nan"), [1], None):
        assert stamp_ns({"stamp": {"sec": odd, "nsec": 1}}) is None
    with pytest.raises(BadInput, match="holds a whole number of 401 digits"):
        number({"v": 10**400}, "v", "here")


def test_chunks_that_hold_more_than_they_state_are_said_to_be_damaged(tmp_path):
    path = write_json(tmp_path / "short.mcap", True, chunk=4000)
    raw, at = bytearray(path.read_bytes()), 8
    while raw[at]:
        length = int.from_bytes(raw[at + 1 : at + 9], "little")
        if raw[at] == 6:  # a chunk: times of its first and last message, then the bytes it states
            raw[at + 25 : at + 33] = (100).to_bytes(8, "little")
        at += 9 + length
        if raw[at : at + 8] == b"\x89MCAP0\r\n":
            break
    path.write_bytes(raw)
    assert "is damaged: it holds more bytes than the 100 it states" in refusal(path, "encoder.angle.deg[0]")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_bytes_are_read_or_refused_never_fatal(data, tmp_path):
    """Whatever is wrong with a file of others, the answer is samples or one sentence."""
    kind = data.draw(st.sampled_from(["json", "protobuf"]))
    path = tmp_path / f"{kind}.mcap"
    if not path.exists():
        write_json(path, True, "header", chunk=4000) if kind == "json" else write_protobuf(path)
    raw = bytearray(path.read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(raw) - 1), min_size=1, max_size=20)):
        raw[at] = data.draw(st.integers(0, 255))
    (tmp_path / "damaged.mcap").write_bytes(raw)
    place = {"json": "encoder.angle.deg[0]", "protobuf": "/drive/state.state.current[1]"}[kind]
    refused = refusal(tmp_path / "damaged.mcap", place)
    assert not refused or "damaged.mcap" in refused


def refusal(path, place: str) -> str:
    """Return the sentence a file is refused with, "" when it is read; everything else goes up."""
    try:
        read_foreign(path, mapping(y_x=place))
    except BadInput as error:
        return str(error)
    return ""


@settings(max_examples=100, deadline=None)
@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), lambda v: st.lists(v) | st.dictionaries(st.text(), v)))
def test_any_json_has_a_stamp_or_none_and_paths_that_hold_numbers(message):
    assert stamp_ns(message) is None or isinstance(stamp_ns(message), int)
    for path in numeric_paths(message):
        assert isinstance(path, str)
