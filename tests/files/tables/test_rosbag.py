"""Bags of ROS 1 and ROS 2, written by the library that reads them elsewhere: mapped like any other topics, and bounded."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from afdsvc.app.init import Answers, init_files
from afdsvc.errors import BadInput
from afdsvc.files import validation
from afdsvc.files.model.model_file import read_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.tables import foreign_mcap, rosbag
from afdsvc.files.tables.mapping import DataMapping, Source

pytest.importorskip("rosbags")
pytest.importorskip("mcap_ros2")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

T = np.arange(200) * 0.01
EFFORT, ANGLE = np.sin(3 * T), np.cos(2 * T)
STATES, FLAGS, BEGAN = "sensor_msgs/msg/JointState", "std_msgs/msg/Bool", 1_700_000_000_000_000_000


def messages(store: Any, old: bool) -> list[tuple[int, Any]]:
    """Return stamp [ns] and message of every sample; it is logged 3 ms later, and more or less."""
    Header, Time, State = (store.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", STATES))
    stamps = [BEGAN + round(t * 1e9) for t in T]
    made = []
    for ns, effort, angle in zip(stamps, EFFORT, ANGLE, strict=True):
        header = Header(**({"seq": 0} if old else {}), stamp=Time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id="")
        made.append((ns, State(header, ["a", "b"], np.array([0.0, angle]), np.zeros(2), np.array([effort, 0.0]))))
    return made


def ros1(path: Path, compression: Any = None) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        states, flags = writer.add_connection("/joint_states", STATES, typestore=store), writer.add_connection("/on", FLAGS, typestore=store)
        for k, (ns, message) in enumerate(messages(store, True)):
            writer.write(states, ns + 3_000_000 + 100_000 * (k % 3), store.serialize_ros1(message, STATES))
            writer.write(flags, ns, store.serialize_ros1(store.types[FLAGS](data=k > 100), FLAGS))
    return path


def ros2(path: Path) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        states = writer.add_connection("/joint_states", STATES, typestore=store)
        for ns, message in messages(store, False):
            writer.write(states, ns + 3_000_000, store.serialize_cdr(message, STATES))
    return path / f"{path.name}.db3"


def mapped(path: Path, **more: str) -> Any:
    places = {"u_effort": "/joint_states.effort[0]", "y_angle": "/joint_states.position[1]", **more}
    mapping = DataMapping(signals={name: Source.model_validate({"from": place}) for name, place in places.items()})
    return open_file(path, Naming(mapping)).traces()


def check(trace: Any) -> None:
    assert trace.dt == pytest.approx(0.01)
    assert trace.column("u_effort") == pytest.approx(EFFORT, abs=1e-12)
    assert trace.column("y_angle") == pytest.approx(ANGLE, abs=1e-12)
    assert "the stamp in its message" in trace.notes["prepared"]


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_topics_of_a_bag_of_ros_1(tmp_path, compression):
    (trace,) = mapped(ros1(tmp_path / "run.bag", compression and Writer1.CompressionFormat[compression]))
    check(trace)


def test_a_topic_that_carries_no_stamp_is_taken_at_the_time_of_its_log(tmp_path):
    (trace,) = mapped(ros1(tmp_path / "run.bag"), aux_on="/on.data")
    assert "'/on' carry no stamp" in trace.notes["prepared"]
    assert set(trace.column("aux_on").tolist()) >= {0.0, 1.0}


@pytest.mark.parametrize("definitions", [True, False])
def test_topics_of_a_bag_of_ros_2_with_its_definitions_or_those_of_ros_itself(tmp_path, definitions):
    path = ros2(tmp_path / "run")
    if not definitions:  # as before ROS 2 Iron
        with sqlite3.connect(path) as base:
            base.execute("DROP TABLE message_definitions")
    (trace,) = mapped(path)
    check(trace)


def test_what_is_there_is_said(tmp_path, monkeypatch):
    for path in (ros1(tmp_path / "run.bag"), ros2(tmp_path / "run")):
        with pytest.raises(BadInput, match=r"no topic for '/odom.x', which is to be aux_x; .* /joint_states \(sensor_msgs/msg/JointState\)"):
            mapped(path, aux_x="/odom.x")
        with pytest.raises(BadInput, match=r"/joint_states.speed: has no such field; expected a number, and it has header.*, position\[0\]"):
            mapped(path, aux_x="/joint_states.speed")
        with pytest.raises(BadInput, match=r"its topics have times of their own; expected a mapping file .*; it has /joint_states\.effort\[0\], /joint_states\.effort\[1\], /joint_states\.position\[0\], .*velocity\[1\](, /on\.data)?$"):
            open_file(path).traces()
        with monkeypatch.context() as patched:
            patched.setattr(foreign_mcap, "_LOOKED", 50)  # a long bag is looked at in part, and closed where it was opened
            with pytest.raises(BadInput, match="it has /joint_states"):
                open_file(path).traces()
    with pytest.raises(BadInput, match=r"run: is a folder; expected a file, such as one in it \(metadata.yaml, run.db3\)"):
        init_files(tmp_path / "run")
    (tmp_path / "text.db3").write_text("no bag\n" * 100)
    (tmp_path / "text.bag").write_text("no bag\n" * 100)
    for name in ("text.db3", "text.bag"):
        with pytest.raises(BadInput, match="not a readable bag"):
            mapped(tmp_path / name)
    with sqlite3.connect(tmp_path / "else.db3") as base:
        base.execute("CREATE TABLE other (id)")
    with pytest.raises(BadInput, match="expected the tables 'topics' and 'messages' of rosbag2"):
        mapped(tmp_path / "else.db3")
    base.close()


@pytest.mark.parametrize("write", [lambda folder: ros1(folder / "run.bag"), lambda folder: ros2(folder / "run")], ids=["ros1", "ros2"])
def test_first_files_of_a_bag(tmp_path, write):
    """Effort and velocity have the field names of inputs and outputs; what never changes is left out."""
    path = write(tmp_path)
    document = init_files(path, tmp_path / "first", Answers(units={"/joint_states.position[1]": "rad", "/joint_states.effort[0]": "N*m"}))
    assert document["columns"] == [
        {"column": "/joint_states.effort[0]", "signal": "u_joint_states_effort_0", "unit": "N*m"},
        {"column": "/joint_states.position[1]", "signal": "y_joint_states_position_1", "unit": "rad"},
    ]
    assert document["left_out"] == {f"/joint_states.{field}": "it never changes" for field in ("effort[1]", "position[0]", "velocity[0]", "velocity[1]")}
    model = read_model(document["model"])
    (trace,) = open_file(path, Naming.of(Path(document["mapping"]))).traces(model)
    np.testing.assert_allclose(trace.column("u_joint_states_effort_0"), EFFORT, atol=1e-9)
    assert [c.unit for c in trace.channels] == ["N*m", "rad"]


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ({"inputs": ["/joint_states.position[1]"], "outputs": ["/joint_states.effort[0]"]}, ["u_joint_states_position_1", "y_joint_states_effort_0"]),
        ({"outputs": ["/on.data"]}, ["u_joint_states_effort_0", "y_on_data"]),
        ({"outputs": ["/joint_states.velocity[0]"]}, r"run\.bag: output /joint_states\.velocity\[0\] never changes; expected one that does: --output COLUMN, one of /joint_states\.position\[0\], "),
        ({"inputs": ["/joint_states.torque"]}, r"no column '/joint_states\.torque'; it has /joint_states\.effort\[0\], "),
    ],
)
def test_places_that_are_named_are_the_only_ones_of_their_role(tmp_path, answers, said):
    path = ros1(tmp_path / "run.bag")
    if isinstance(said, str):
        with pytest.raises(BadInput, match=said):
            init_files(path, answers=Answers(**answers))
    else:
        assert {c["signal"] for c in init_files(path, answers=Answers(**answers))["columns"]} == set(said)


def test_a_bag_that_ends_early_is_refused_with_the_cure(tmp_path):
    path = ros1(tmp_path / "run.bag")
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(BadInput, match="not a readable bag"):
        mapped(path)


def test_a_chunk_that_expands_too_far_is_refused(tmp_path, monkeypatch):
    path = ros1(tmp_path / "run.bag", Writer1.CompressionFormat.BZ2)
    monkeypatch.setattr(rosbag, "BOUNDS", validation.Bounds(chunk=10_000))
    with pytest.raises(BadInput, match="a chunk holds 10,000 bytes or more"):
        mapped(path)


def test_an_index_read_again_and_again_is_refused(tmp_path, monkeypatch):
    path = ros1(tmp_path / "run.bag")
    monkeypatch.setattr(rosbag, "file_size", lambda path, most: 12 * 399)  # a file of that size holds fewer entries
    with pytest.raises(BadInput, match=r"holds 400 entries in its index; at most 399"):
        mapped(path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("Part[100000] parts\n" + "=" * 80 + "\nMSG: a/Part\nuint8 x\n", "100,000 elements in arrays of fixed length; at most 65,536"),
        ("Part[] parts\n" + "=" * 80 + "\nMSG: a/Part\n", "fields of no bytes"),
        ("Message other\n", "its schema cannot be read: RecursionError"),
    ],
)
def test_a_type_by_which_no_bytes_become_many_values_is_refused(text, sentence):
    with pytest.raises(BadInput, match=sentence):
        rosbag.ros1_decoder(rosbag.Schema(1, text.encode(), "ros1msg", "a/msg/Message"), "run.bag: topic '/x'")


def test_the_name_of_a_type_is_no_code(tmp_path):
    """The library writes the name of a type into code that it runs."""
    mark = tmp_path / "mark"
    name = f'a/msg/B:\n    """x"""\nopen({str(mark)!r}, "w")\nclass C'
    with pytest.raises(BadInput, match="its schema cannot be read"):
        rosbag.ros1_decoder(rosbag.Schema(1, b"float64 x\n", "ros1msg", name), "run.bag: topic '/x'")
    assert not mark.exists()


def test_a_view_in_place_of_messages_is_refused(tmp_path):
    """A view can compute any number of rows for ever."""
    with sqlite3.connect(tmp_path / "view.db3") as base:
        base.execute("CREATE TABLE topics (id, name, type)")
        base.execute("CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT 1 topic_id, i timestamp, zeroblob(9) data FROM n")
    base.close()
    with pytest.raises(BadInput, match="expected the tables 'topics' and 'messages' of rosbag2"):
        mapped(tmp_path / "view.db3")
