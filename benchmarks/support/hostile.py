"""What afdsvc reads from others, and inputs made to break it: every target must end in a value or in `AfdsvcError`.

A target is a pair of ``make(rng) -> input`` and ``eat(input)``. `TARGETS` opens them by name in a scratch folder.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.signals import Block, Channel
from afdsvc.app import commissioning, ports
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import DriverSection, MachineSection, parse_site
from afdsvc.files.tables.tables import read_table
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock
from afdsvc.wire import codec
from afdsvc.wire.messages import BurstRequest
from benchmarks.support.messages import EXAMPLES
from benchmarks.support.mutation import mutate_bytes, mutate_text

MODEL = """name = "axis"
time = "discrete"
sample_time = 0.001
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "m"}]
states = [{name = "q", unit = "m"}, {name = "v", unit = "m/s", rate_of = "q"}]
A = [[1, 0.001], [0, 0.998]]
B = [[0], [1e-5]]
C = [[1, 0]]
D = [[0]]
[parameters]
mass = {value = 95.1, unit = "kg", relative_sd = 0.02}
[uncertainty]
relative = 0.02
A = [[0, 0], [0, 0.1]]
[noise]
output_sd = [2e-6]
[controller]
time = "discrete"
sample_time = 0.001
A = []
B = []
C = []
D = [[-1.0]]
"""
CONTINUOUS = MODEL.replace('time = "discrete"\nsample_time = 0.001\ninputs', 'time = "continuous"\ninputs')
SITE = """site = "hall-3"
[transport]
listen = ["tcp/127.0.0.1:7447"]
cache_blocks = 400
[recording]
folder = "recordings"
max_megabytes = 100
keep_days = 30
[review]
rerun = "off"
[alarms]
latch = true
notify = [{kind = "webhook", settings = {url = "http://127.0.0.1/x"}}]
[[machines]]
id = "bearing"
plant = "gas_bearing"
options = {rpm = 300}
driver = {kind = "simulator", seed = 4, faults = [{name = "vertical_actuator", severity = -0.5, at_seconds = 4.0}]}
controller = {kind = "proportional", settings = {gain = 0.2}}
bursts = {every_seconds = 3.5, quiet_hours = [["22:00", "06:00"]]}
limits = {output = [10.0, 10.0], seconds = 10.0}
detectors = [{kind = "matched_filter", false_alarms_per_1000_bursts = 2.0}]
[[machines]]
id = "axis"
model = "axis.toml"
calibrate_seconds = 10
"""


@dataclass(frozen=True, slots=True)
class Target:
    """How an input is made from a generator, and what is done with it."""

    make: Callable[[Random], Any]
    eat: Callable[[Any], object]

    def try_one(self, rng: Random) -> bool:
        """Make and eat one input; returns whether it was accepted. Anything but `AfdsvcError` comes out."""
        try:
            self.eat(self.make(rng))
        except AfdsvcError:
            return False
        return True


def wire(_folder: Path) -> Target:
    """Every message of the wire; what is accepted must also be sendable again."""
    kinds = [(decode, codec.encode_block if decode is codec.decode_block else codec.encode, data) for decode, data in EXAMPLES]

    def make(rng: Random) -> tuple[Any, Any, bytes]:
        decode, encode, data = rng.choice(kinds)
        return decode, encode, mutate_bytes(data, rng.choice(kinds)[2], rng)

    def eat(item: tuple[Any, Any, bytes]) -> None:
        decode, encode, data = item
        encode(decode(data))

    return Target(make, eat)


def recording(folder: Path) -> Target:
    """Recordings: opened, everything in them decoded, recovered."""
    path = folder / "mutant.mcap"
    seeds = [_recording(folder / f"seed{n}.mcap", n) for n in (1, 3)]
    seeds.append(seeds[1][: len(seeds[1]) * 2 // 3])

    def eat(data: bytes) -> None:
        path.write_bytes(data)
        found = Recording(path)
        for kind in (found.events, found.requests):
            list(kind())
        _ = found.loss, found.site
        found.traces()

    return Target(lambda rng: mutate_bytes(rng.choice(seeds), rng.choice(seeds), rng), eat)


def _recording(path: Path, blocks: int) -> bytes:
    channels = (Channel("u_x", "V"), Channel("y_x", "um"))
    rng = np.random.default_rng(0)
    recorder = Recorder(
        RecordingSettings(path, flush_seconds=0.0, preview_hertz=5.0, overwrite=True), Header("site", {"m1": MODEL}), lambda: 0.0
    )
    for seq in range(blocks):
        block = Block("m1", "s1", seq, seq * 20, 1e-3, 1_763_000_000_000_000_000 + seq, channels, rng.normal(size=(20, 2)))
        recorder.block(codec.encode_block(block), block)
    recorder.close()
    return path.read_bytes()


def _table(suffix: str, seeds: Callable[[], list[bytes]]) -> Callable[[Path], Target]:
    def opened(folder: Path) -> Target:
        path, whole = folder / f"mutant{suffix}", seeds()

        def eat(data: bytes) -> None:
            path.write_bytes(data)
            read_table(path)

        return Target(lambda rng: mutate_bytes(rng.choice(whole), rng.choice(whole), rng), eat)

    return opened


COLUMNS = {"t": np.arange(30) * 0.01, "u_force": np.sin(np.arange(30.0)), "y_position": np.cos(np.arange(30.0))}


def _csv() -> list[bytes]:
    rows = "".join(",".join(map(repr, row)) + "\n" for row in zip(*(c.tolist() for c in COLUMNS.values()), strict=True))
    plain = (",".join(COLUMNS) + "\n" + rows).encode()
    return [plain, plain.replace(b",", b";").replace(b".", b",")]


def _saved(save: Callable[[io.BytesIO], object]) -> bytes:
    stream = io.BytesIO()
    save(stream)
    return stream.getvalue()


def _npz() -> list[bytes]:
    return [_saved(lambda s: np.savez(s, **COLUMNS)), _saved(lambda s: np.savez_compressed(s, **COLUMNS))]


def _parquet() -> list[bytes]:
    return [_saved(partial(pq.write_table, pa.table(COLUMNS), compression=c)) for c in ("none", "snappy")]


def _mat() -> list[bytes]:
    save: Any = scipy.io.savemat
    return [_saved(partial(save, mdict=COLUMNS, do_compression=c)) for c in (False, True)]


def _hdf() -> list[bytes]:
    def save(stream: io.BytesIO) -> None:
        with h5py.File(stream, "w") as file:
            for name, values in COLUMNS.items():
                file[name] = values.reshape(1, -1)

    return [_saved(save)]


def _tdms() -> list[bytes]:
    from nptdms import ChannelObject, TdmsWriter

    def save(stream: io.BytesIO) -> None:
        with TdmsWriter(stream) as writer:
            for _ in range(2):
                writer.write_segment([ChannelObject("run", name, values, {"wf_increment": 0.01}) for name, values in COLUMNS.items()])

    return [_saved(save)]


def ulog(folder: Path) -> Target:
    """Logs of PX4, through a mapping."""
    path = folder / "mutant.ulg"
    (folder / "map.toml").write_text("[signals]\nu_force = 'force.x[0]'\ny_position = 'position.y'\n")
    naming = Naming.of(folder / "map.toml")
    formats = ("force:uint64_t timestamp;float[2] x;", "point:uint64_t timestamp;float y;", "position:uint64_t timestamp;float y;point p;")
    said = b"".join(_ulog(b"F", f.encode()) for f in formats) + _ulog(b"A", b"\0\0\0force") + _ulog(b"A", b"\0\1\0position")
    for k in range(80):
        said += _ulog(b"D", struct.pack("<HQff", 0, 4000 * k, k, k)) + _ulog(b"D", struct.pack("<HQfQf", 1, 4000 * k, k, 0, k))
    whole = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + said

    def eat(data: bytes) -> None:
        path.write_bytes(data)
        open_file(path, naming).traces()

    eat(whole)
    return Target(lambda rng: mutate_bytes(whole, whole, rng), eat)


def _ulog(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def _bag(suffix: str) -> Callable[[Path], Target]:
    def target(folder: Path) -> Target:
        """Bags of ROS, through a mapping."""
        path = folder / f"mutant{suffix}"
        (folder / "map.toml").write_text("[signals]\nu_force = '/force.vector.x'\n")
        naming, whole = Naming.of(folder / "map.toml"), bag(folder / f"whole{suffix}", 60).read_bytes()

        def eat(data: bytes) -> None:
            path.write_bytes(data)
            open_file(path, naming).traces()

        eat(whole)
        return Target(lambda rng: mutate_bytes(whole, whole, rng), eat)

    return target


def bag(path: Path, samples: int) -> Path:
    """Write a bag of ROS 1 (``.bag``) or ROS 2 (``.db3``) with one topic, `/force`, and return its path."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    new, kind = path.suffix == ".db3", "geometry_msgs/msg/Vector3Stamped"
    store = get_typestore(Stores.ROS2_HUMBLE if new else Stores.ROS1_NOETIC)
    Stamped, Header, Time, Vector = (store.types[n] for n in (kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Vector3"))
    whole = rosbag2.Writer(path.with_suffix(""), version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3) if new else rosbag1.Writer(path)
    with whole as writer:
        topic = writer.add_connection("/force", kind, typestore=store)
        for k in range(samples):
            stamp = Time(sec=100, nanosec=10_000_000 * k)
            message = Stamped(Header(**({} if new else {"seq": k}), stamp=stamp, frame_id=""), Vector(x=np.sin(k), y=0.0, z=0.0))
            writer.write(topic, 100 * 10**9 + 10_000_000 * k, (store.serialize_cdr if new else store.serialize_ros1)(message, kind))
    return path.with_suffix("") / path.name if new else path


def _text(parse: Callable[[str], object], seeds: list[str]) -> Callable[[Path], Target]:
    return lambda _folder: Target(lambda rng: mutate_text(rng.choice(seeds), rng.choice(seeds), rng), parse)


def burst(_folder: Path) -> Target:
    """Requests to excite a simulated machine: refused, or played without any limit being exceeded."""
    plugins = load()
    config = MachineSection(id="m1", plant="gas_bearing", driver=DriverSection(real_time=False))
    machine = commissioning.commission(config, plugins)
    port: Any = ports.open_port(machine, "s", FastClock(), plugins)
    if machine.limits is None:
        raise BadInput("the gas bearing has no limits; expected a machine that can be excited")
    return Target(_burst_request, partial(_play, port, machine.limits))


def _burst_request(rng: Random) -> bytes:
    samples, ramp = rng.choice((1, 2, 99, 1000, 2999)), rng.choice((0, 0, 1, 20, 250))
    scale = 10 ** rng.uniform(-2, 3)
    inputs = rng.choice((2, 2, 2, 2, 1, 3))
    lines = [Line(rng.randrange(inputs), rng.uniform(-1e3, 2e4), rng.gauss(0, scale), rng.uniform(-9, 9)) for _ in range(rng.randrange(4))]
    wave = np.array([[rng.gauss(0, scale) for _ in range(inputs)] for _ in range(samples)]) if rng.random() < 0.1 else None
    made = Burst("b", inputs, samples, min(ramp, samples // 2), tuple(lines), wave)
    data = codec.encode(BurstRequest("m1", made, 2.0, "fuzz", 1))
    return mutate_bytes(data, data, rng) if rng.random() < 0.3 else data


def _play(port: Any, limits: Limits, data: bytes) -> None:
    request = codec.decode(BurstRequest, data)
    port.check(request.burst, limits)
    blocks = []
    with port.arm(limits) as drive:
        drive.play(request.burst)
        while drive.playing:
            blocks.append(port.read())
    blocks.append(port.read())
    u, y, alpha = (np.vstack([b.role(role) for b in blocks]) for role in ("u", "y", "alpha"))
    _demand((np.abs(u) <= limits.input).all(), "an input beyond its limit")
    _demand((np.abs(alpha) <= limits.alpha).all(), "an excitation beyond its limit")
    over = np.flatnonzero((np.abs(y) > limits.output).any(axis=1))
    _demand(not over.size or not alpha[over[0] :].any(), "excitation goes on beyond an output's limit")
    _demand(not blocks[-1].role("alpha").any(), "the machine is not at rest afterwards")


def _demand(holds: Any, otherwise: str) -> None:
    if not holds:
        raise RuntimeError(otherwise)


TARGETS: dict[str, Callable[[Path], Target]] = {
    "wire": wire,
    "burst": burst,
    "recording": recording,
    "csv": _table(".csv", _csv),
    "npz": _table(".npz", _npz),
    "parquet": _table(".parquet", _parquet),
    "mat": _table(".mat", _mat),
    "mat73": _table(".mat", _hdf),
    "tdms": _table(".tdms", _tdms),
    "ulog": ulog,
    "bag": _bag(".bag"),
    "db3": _bag(".db3"),
    "model": _text(lambda text: parse_model(text, "mutant.toml"), [MODEL, CONTINUOUS]),
    "site": _text(lambda text: parse_site(text, "mutant.toml"), [SITE]),
}
