"""MCAP files of others: JSON, protobuf and ROS 2 topics by name, on one grid, in the model's units.

    python recordings_mcap.py          # writes json.mcap, protobuf.mcap, ros2.mcap and their mapping files, and reads them
    afdsvc import ros2.mcap -o ours.mcap --mapping ros2.toml

The ROS 2 part needs the extra: pip install "afdsvc[ros]"
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from google.protobuf.wrappers_pb2 import DoubleValue
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter

from afdsvc.app.diagnose import import_recording

T0, N = 1_763_000_000_000_000_000, 4000
TIMES = T0 + np.arange(N) * 1_000_000
CURRENT, ANGLE = np.sin(2 * np.pi * 3 * np.arange(N) / 1000), 30 * np.cos(2 * np.pi * 3 * np.arange(N) / 1000)
MAPPING = """
[time]
from = "{time}"
[signals]
u_force = {{from = "{force}", unit = "A", factor = 2.5, factor_unit = "N/A", to = "N"}}
y_angle = {{from = "{angle}", unit = "deg", to = "rad"}}
"""
JOINT = """std_msgs/Header header
float64[] position
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def write_json() -> None:
    """A drive that logs at 1 kHz and an encoder at 250 Hz, as JSON without a schema."""
    with open("json.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        drive, encoder = (writer.register_channel(name, "json", 0) for name in ("/drive", "/encoder"))
        for k, t in enumerate(TIMES.tolist()):
            writer.add_message(drive, t, json.dumps({"current": {"q": CURRENT[k]}}).encode(), t)
            if k % 4 == 0:
                writer.add_message(encoder, t, json.dumps({"deg": [ANGLE[k]]}).encode(), t)
        writer.finish()
    Path("json.toml").write_text(MAPPING.format(time="log", force="/drive.current.q", angle="/encoder.deg[0]"))


def write_protobuf() -> None:
    """Two topics of a message type every protobuf brings; any other type with numbers in it works as well."""
    with open("protobuf.mcap", "wb") as file, ProtobufWriter(file) as writer:
        for k, t in enumerate(TIMES.tolist()):
            writer.write_message("/drive/current", DoubleValue(value=CURRENT[k]), log_time=t, publish_time=t)
            writer.write_message("/encoder/angle", DoubleValue(value=ANGLE[k]), log_time=t, publish_time=t)
    Path("protobuf.toml").write_text(MAPPING.format(time="publish", force="/drive/current.value", angle="/encoder/angle.value"))


def write_ros2() -> bool:
    """A topic like sensor_msgs/msg/JointState, its time in the header."""
    if not find_spec("mcap_ros2"):
        print("the ROS 2 part needs afdsvc[ros]")
        return False
    from mcap_ros2.writer import Writer as RosWriter

    with open("ros2.mcap", "wb") as file:
        writer = RosWriter(file)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT)
        for k, t in enumerate(TIMES.tolist()):
            header = {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": ""}
            message = {"header": header, "position": [0.0, ANGLE[k]], "effort": [0.0, CURRENT[k]]}
            writer.write_message("/joint_states", schema, message, t + 300_000, t)
        writer.finish()
    Path("ros2.toml").write_text(MAPPING.format(time="header", force="/joint_states.effort[1]", angle="/joint_states.position[1]"))
    return True


if __name__ == "__main__":
    write_json()
    write_protobuf()
    for name in ("json", "protobuf", *(["ros2"] if write_ros2() else [])):
        Path(f"{name}-ours.mcap").unlink(missing_ok=True)  # recordings are not overwritten unasked
        made = import_recording(Path(f"{name}.mcap"), Path(f"{name}-ours.mcap"), None, {}, Path(f"{name}.toml"))
        print(f"\n{made['recording']}: {made['samples']} samples every {made['dt']} s: {', '.join(made['channels'])}", *made["notes"], sep="\n")
