"""Foreign tables: numbers bit for bit, and the row and column of whatever is wrong."""

import os
import struct
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from afdsvc.api.signals import Channel
from afdsvc.app.init import Answers, init_files
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.tables.formats import opened, read_columns
from afdsvc.files.tables.tables import read_table, with_units

RNG = np.random.default_rng(3)
T = np.round(np.arange(200) * 0.004 + 1.0, 6)
COLUMNS = {"t": T, "u_force": RNG.normal(size=200), "y_position": RNG.normal(size=200) * 1e-7}


def write(path: Path, columns: dict) -> Path:
    match path.suffix:
        case ".csv":
            rows = zip(*(c.tolist() for c in columns.values()), strict=True)
            path.write_text(",".join(columns) + "\n" + "".join(",".join(map(repr, r)) + "\n" for r in rows))
        case ".parquet":
            pq.write_table(pa.table(columns), path)
        case ".npz":
            np.savez(path, **columns)
        case ".mat":
            scipy.io.savemat(path, columns)
    return path


def write_mat73(path: Path, columns: dict, group: str = "") -> Path:
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_group("#refs#")
        place = file.create_group(group) if group else file
        for name, values in columns.items():
            place[name] = values.reshape(1, -1)  # MATLAB keeps a column vector transposed
    raw = bytearray(path.read_bytes())
    raw[:24] = b"MATLAB 7.3 MAT-file, and"
    path.write_bytes(raw)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz", ".mat", "7.3.mat"])
def test_every_format_gives_the_same_trace(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    trace = read_table((write_mat73 if suffix == "7.3.mat" else write)(path, COLUMNS))
    assert [c.name for c in trace.channels] == ["u_force", "y_position"]
    assert trace.column("u_force").tobytes() == COLUMNS["u_force"].tobytes()
    assert trace.column("y_position").tobytes() == COLUMNS["y_position"].tobytes()
    assert (trace.dt, trace.t0, trace.name) == (0.004, 1.0, path.name)


def test_a_struct_of_vectors_is_a_table(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"run": COLUMNS})
    for path in (tmp_path / "a.mat", write_mat73(tmp_path / "b.mat", COLUMNS, "run")):
        assert read_table(path).column("u_force").tobytes() == COLUMNS["u_force"].tobytes()


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 2**64 - 1), min_size=3, max_size=30))
def test_csv_is_exact_to_the_last_bit(bits):
    values = np.array(
        [b for b in bits if np.isfinite(struct.unpack("<d", struct.pack("<Q", b))[0])] + [0], dtype=np.uint64
    )
    values = values.view(np.float64)
    path = Path(os.environ.get("TMPDIR", "/tmp")) / f"afdsvc-exact-{os.getpid()}.csv"
    try:
        write(path, {"u_x": values})
        assert read_table(path, dt=0.1).column("u_x").tobytes() == values.tobytes()
    finally:
        path.unlink(missing_ok=True)


def text(path: Path, content: str) -> Path:
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    "content",
    ["\ufefft, u_a ,y_b\n0, 1.5 ,2\n1,1.5,2\n", "t;u_a;y_b\n0;1,5;2\n1;1,5;2\n", "t\tu_a\ty_b\n0\t1.5\t2\n1\t1.5\t2\n"],
)
def test_other_people_write_csv_otherwise(tmp_path, content):
    trace = read_table(text(tmp_path / "a.csv", content))
    assert trace.values.tolist() == [[1.5, 2.0], [1.5, 2.0]]
    assert [c.name for c in trace.channels] == ["u_a", "y_b"]


STAMPS = {
    "zone": ["2026-10-25T02:59:59.990+02:00", "2026-10-25T02:59:59.995+02:00", "2026-10-25T02:00:00.000+01:00", "2026-10-25T02:00:00.005+01:00"],
    "utc": [f"2026-11-21T10:00:00.{5 * k:03d}Z" for k in range(4)],
    "none": [f"2026-11-21 10:00:00,{5 * k:03d}" for k in range(4)],
}


@pytest.mark.parametrize(("kind", "start"), [("zone", "2026-10-25T00:59:59.990000"), ("utc", "2026-11-21T10:00:00.000000"), ("none", "2026-11-21T10:00:00.000000")])
def test_time_stamps_become_seconds(tmp_path, kind, start):
    """The first ones go over the end of summer time: the zone counts, not the hour that is written."""
    path = tmp_path / "log.csv"
    path.write_text("Zeit;u_force;y_position\n" + "".join(f"{stamp};1;{k}\n" for k, stamp in enumerate(STAMPS[kind])))
    trace = read_table(path)
    assert (trace.t0, trace.dt, [c.name for c in trace.channels]) == (0.0, 0.005, ["u_force", "y_position"])
    assert f"column Zeit holds time stamps; t = 0 is {start}" in trace.notes["prepared"]


def test_dates_in_parquet_become_seconds(tmp_path):
    stamps = np.datetime64("2026-11-21T10:00:00", "us") + 5000 * np.arange(4)
    pq.write_table(pa.table({"when": stamps, "u_force": np.zeros(4)}), tmp_path / "log.parquet")
    assert read_table(tmp_path / "log.parquet").dt == 0.005


def test_milliseconds_in_the_name_of_the_time(tmp_path):
    (tmp_path / "log.csv").write_text("t_ms,u_force\n0,1\n5,2\n10,3\n")
    trace = read_table(tmp_path / "log.csv")
    assert (trace.dt, trace.notes["prepared"]) == (0.005, "t is t_ms, converted to s")


def test_columns_are_renamed_and_left_out(tmp_path):
    path = text(tmp_path / "a.csv", "time,Force [N],u_old,junk\n0,1,2,3\n0.5,1,2,3\n")
    mapping = {"time": "t", "Force [N]": "u_force", "u_old": "u_new", "junk": ""}
    trace = read_table(path, mapping)
    assert [c.name for c in trace.channels] == ["u_force", "u_new"]
    assert trace.dt == 0.5


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        ("t,force\n0,1\n1,2\n", {}, ["'force' has no role", "u_<name>", "mapping"]),
        ("t,u_a\n0,1\n1,2\n", {"mapping": {"x": "u_x"}}, ["no column 'x'", "t, u_a"]),
        ("t,u_a,u_b\n0,1,1\n1,2,2\n", {"mapping": {"u_b": "u_a"}}, ["two columns", "'u_a'"]),
        ("t,u_a,u_a\n0,1,1\n1,2,2\n", {}, ["'u_a' comes twice"]),
        ("t,u_a\n0,1\n1,abc\n", {}, ["'u_a', row 2", "'abc'"]),
        ("t,u_a\n0,1\n1\n", {}, ["row 2 has 1 cells", "expected 2"]),
        ("t,u_a\n0,1\n1,\n2,3\n", {}, ["'u_a', row 2", "nan", "1 such"]),
        ("t,u_a\n0,1\n1,inf\n2,inf\n", {}, ["'u_a', row 2", "inf", "2 such"]),
        ("t,u_a\n0,1\n,1\n2,1\n", {}, ["'t', row 2 holds nan"]),
        ("t,u_a\n0,1\n1,1\n1,1\n3,1\n", {}, ["'t', row 3 goes from", "1 to 1"]),
        ("t,u_a\n0,1\n1,1\n0.5,1\n", {}, ["'t', row 3 goes from"]),
        ("t,u_a\n0,1\n1,1\n2,1\n5,1\n6,1\n", {}, ["'t', row 4", "3 s after", "1 s is usual", "gap"]),
        ("t,u_a\n0,1\n1,1\n2.3,1\n3,1\n4,1\n", {}, ["'t', row 3 misses", "0.3 s"]),
        ("t,u_a\n0,1\n", {}, ["'t' holds 1 rows"]),
        ("t,u_a\n", {}, ["no rows"]),
        ("u_a\n1\n2\n", {}, ["no column 't'", "sample time"]),
        ("t,u_a\n0,1\n1,2\n", {"dt": 0.5}, ["sample time of 1 s", "expected 0.5 s"]),
        ("t\n0\n1\n", {}, ["no signal"]),
        ("", {}, ["Empty CSV file"]),
        ("0.0,1.5,2.5\n0.1,1,2\n", {}, ["first row holds numbers", "--map 1=t --map 2=u_force"]),
        ("0.0,1.5\n0.1,x\n", {}, ["column '2', row 2 holds 'x'"]),
        ("t,speed_rpm\n0,1\n1,2\n", {}, ["'speed_rpm' has no role", "--map", "afdsvc init"]),
        ("t,u_a\n2026-11-21T10:00:00,1\n2026-11-21T10:00:01Z,2\n", {}, ["'t', row 2", "zone in all rows or in none"]),
        ("t,u_a\n2026-11-21T10:00:00,1\nlater,2\n", {}, ["'t', row 2 holds 'later'", "2026-11-21T10:00:00.125+01:00"]),
        ("t,when,u_a\n0,2026-11-21T10:00:00,1\n1,2026-11-21T10:00:00,1\n", {}, ["'when' holds time stamps", "--map when="]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, content, options, words):
    path = text(tmp_path / "a.csv", content)
    with pytest.raises(BadInput) as error:
        read_table(path, **options)
    assert all(word in str(error.value) for word in [str(path), *words]), str(error.value)


def test_nan_is_data_when_asked_for(tmp_path):
    path = text(tmp_path / "a.csv", "t,u_a\n0,1\n1,NaN\n2,\n")
    assert np.array_equal(read_table(path, allow_nan=True).column("u_a"), [1, np.nan, np.nan], equal_nan=True)


def test_a_sample_time_that_differs_by_rounding_is_the_given_one(tmp_path):
    path = text(tmp_path / "a.csv", "t,u_a\n0,1\n0.333,1\n0.667,1\n1,1\n")
    assert read_table(path, dt=1 / 3).dt == 1 / 3


@pytest.mark.parametrize("dt", [1e-3, 2e-4, 0.0016384, 1 / 610.35, 0.05])
@pytest.mark.parametrize("digits", [9, 17])
def test_the_sample_time_is_the_number_meant(tmp_path, dt, digits):
    t = np.array([float(f"{k * dt:.{digits}g}") for k in range(3000)])
    found = read_table(write(tmp_path / "a.csv", {"t": t, "u_a": t})).dt
    assert abs(found - dt) * 3000 < 1e-2 * dt
    assert found == dt or len(repr(dt)) > 10


@pytest.mark.parametrize(
    ("name", "raw", "words"),
    [
        ("a.xlsx", b"", "end in .csv, .parquet, .mat, .npz, .tdms; this one ends in '.xlsx'"),
        ("a.csv", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS pointer"),
        ("a.csv", b"t,u_\xe6\n", "not a readable .csv"),
        ("a.parquet", b"PAR1 but no more", "not a readable .parquet"),
        ("a.npz", b"not a zip file at all", "not a readable .npz"),
        ("a.npz", b"PK\x03\x04torn", "not a readable .npz"),
        ("a.mat", b"\x00" * 300, "not a readable .mat"),
        ("a.mat", b"", "not a readable .mat"),
        ("a.mat", b"\x89HDF\r\n\x1a\n" + b"\x00" * 90, "not a readable .mat"),
    ],
)
def test_files_that_are_something_else_are_named(tmp_path, name, raw, words):
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(BadInput, match=words) as error:
        read_table(tmp_path / name)
    assert str(tmp_path / name) in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(BadInput, match=r"none\.csv: cannot be read: No such file"):
        read_table(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"u_a": np.zeros((3, 2, 2))}, r"'u_a' has shape \(3, 2, 2\)"),
        ({"u_a": np.array(["x", "y"])}, "'u_a' holds <U1"),
        ({"u_a": np.array([1j])}, "'u_a' holds complex128"),
        ({"u_a": np.array([2**60 + 1])}, "beyond 2\\*\\*53"),
        ({"u_a": np.zeros(3), "y_a": np.zeros(4)}, "'u_a' 3, 'y_a' 4"),
        ({"u_a": np.array([{}])}, "not a readable .npz"),
    ],
)
def test_arrays_that_are_no_columns_are_named(tmp_path, columns, words):
    np.savez(tmp_path / "a.npz", **columns)
    with pytest.raises(BadInput, match=words):
        read_table(tmp_path / "a.npz", dt=1.0)


def test_one_bare_array_is_no_table(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(3))
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    with pytest.raises(BadInput, match="holds one array"):
        read_table(tmp_path / "a.npz")


def test_a_struct_beside_other_variables_is_named(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["u_a"] = np.zeros((1, 3))
        file.create_group("s")["x"] = np.zeros(3)
    with pytest.raises(BadInput, match="'s' is a struct beside others"):
        read_table(tmp_path / "a.mat", dt=1.0)


def test_units_come_from_the_model(tmp_path):
    model = parse_model(
        'name="m"\ntime="continuous"\ninputs=[{name="force", unit="N"}]\noutputs=[{name="position", unit="m"}]\n'
        "A=[]\nB=[]\nC=[]\nD=[[1]]",
        "m.toml",
    )
    path = text(tmp_path / "a.csv", "t,u_force,y_position,ref_position,aux_speed\n0,1,2,3,4\n1,1,2,3,4\n")
    units = {c.name: c.unit for c in with_units(read_table(path), model).channels}
    assert units == {"u_force": "N", "y_position": "m", "ref_position": "m", "aux_speed": ""}
    assert with_units(read_table(path), model).channels[0] == Channel("u_force", "N")


@pytest.mark.parametrize(
    ("name", "dt", "rows"),
    [("emps/estimation", 0.001, 24841), ("silverbox/arrow", 0.0016384, 40475), ("two_mass/multisine_A", 0.0004, 25000)],
)
def test_measured_benchmarks(measured, name, dt, rows):
    trace = read_table(measured / f"{name}.csv")
    assert (trace.dt, len(trace)) == (dt, rows)


MODEL = parse_model("""
name = "plate"
time = "discrete"
sample_time = 0.004
inputs = [{name = "left", unit = "N"}, {name = "right", unit = "N"}]
outputs = [{name = "height", unit = "mm"}]
A = [[0.5]]
B = [[1.0, 1.0]]
C = [[1.0]]
""", "MODEL.toml")


def test_a_table_without_header_is_named_by_the_number_of_its_columns(tmp_path):
    path = text(tmp_path / "a.csv", "2026-11-21T10:00:00Z;1,5;7\n2026-11-21T10:00:01Z;2,5;7\n")
    trace = read_table(path, {"1": "t", "2": "u_force", "3": ""})
    assert (trace.dt, [c.name for c in trace.channels], trace.column("u_force").tolist()) == (1.0, ["u_force"], [1.5, 2.5])


def test_columns_named_like_the_model_need_no_role(tmp_path):
    path = write(tmp_path / "run.csv", {"t": T, "right": COLUMNS["u_force"], "left": 2 * COLUMNS["u_force"], "height": COLUMNS["y_position"]})
    (trace,) = open_file(path).traces(MODEL)
    assert [(c.name, c.unit) for c in trace.channels] == [("u_right", "N"), ("u_left", "N"), ("y_height", "mm")]
    with pytest.raises(BadInput, match="'right' has no role"):
        open_file(path).traces()


@pytest.mark.parametrize("suffix", [".npz", ".mat", "7.3.mat"])
def test_the_columns_of_a_matrix_are_the_models_channels_in_order(tmp_path, suffix):
    u, y = RNG.normal(size=(200, 2)), RNG.normal(size=(200, 1))
    path = tmp_path / f"run{suffix}"
    if suffix == "7.3.mat":
        with h5py.File(path, "w") as file:
            file["u"], file["y"] = u.T, y.T  # as MATLAB keeps them
    else:
        write(path, {"u": u, "y": y})
    (trace,) = open_file(path).traces(MODEL, gaps=True)
    assert [c.name for c in trace.channels] == ["u_left", "u_right", "y_height"]
    assert np.array_equal(trace.values, np.hstack([u, y]))
    assert [c.name for c in read_table(path, {"y": "y_1"}, 0.1).channels] == ["u_1", "u_2", "y_1"]


def test_a_tdms_file_is_a_table_with_the_time_of_its_properties(tmp_path, caplog, capfd):
    nptdms = pytest.importorskip("nptdms")
    properties = {"wf_increment": 0.004, "wf_start_offset": 1.0}
    channels = [nptdms.ChannelObject("run", name, COLUMNS[name], properties) for name in ("u_force", "y_position")]
    with nptdms.TdmsWriter(str(tmp_path / "run.tdms")) as writer:
        writer.write_segment(channels)
    trace = read_table(tmp_path / "run.tdms")
    assert (trace.t0, trace.dt, [c.name for c in trace.channels]) == (1.0, 0.004, ["u_force", "y_position"])
    assert trace.column("y_position").tobytes() == COLUMNS["y_position"].tobytes()
    whole = (tmp_path / "run.tdms").read_bytes()
    (tmp_path / "torn.tdms").write_bytes(whole[:-800])
    torn = read_columns(tmp_path / "torn.tdms")
    assert all(np.array_equal(torn[name], COLUMNS[name][: len(torn[name])]) for name in torn if name != "t")
    assert [record.message for record in caplog.records] == [f"{tmp_path / 'torn.tdms'}: the file ends within a segment; what is whole is read"]
    assert "nptdms" not in capfd.readouterr().err
    (tmp_path / "no.tdms").write_bytes(b"something else")
    with pytest.raises(BadInput, match=r"no\.tdms: not a readable \.tdms file"):
        read_table(tmp_path / "no.tdms")


def ulog(path: Path, topics: dict[str, tuple[str, np.ndarray, np.ndarray]]) -> Path:
    """Write a log as PX4 does: topic to (field, times [us], values)."""
    said = b""
    formats = [(b"F", f"{name}:uint64_t timestamp;float {field};".encode()) for name, (field, *_) in topics.items()]
    for kind, content in (*formats, *((b"A", struct.pack("<BH", 0, number) + name.encode()) for number, name in enumerate(topics))):
        said += struct.pack("<H", len(content)) + kind + content
    for number, (_, times, values) in enumerate(topics.values()):
        for t, v in zip(times.tolist(), values.tolist(), strict=True):
            said += struct.pack("<HcHQf", 14, b"D", number, t, v)
    path.write_bytes(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + said)
    return path


def test_topics_of_a_ulog_come_to_one_rate_by_a_mapping(tmp_path):
    pytest.importorskip("pyulog")
    fast, slow = np.arange(4000) * 4000 + 10**6, np.arange(1600) * 10_000 + 10**6
    path = ulog(tmp_path / "flight.ulg", {"thrust": ("force", fast, np.sin(fast * 5e-6)), "position": ("z", slow, np.cos(slow * 5e-6))})
    mapping = text(tmp_path / "m.toml", "[signals]\nu_thrust = {from = 'thrust.force', unit = 'N'}\ny_height = {from = 'position.z', unit = 'm'}\n")
    (trace,) = open_file(path, Naming.of(mapping)).traces()
    t = trace.t0 + trace.dt * np.arange(len(trace))
    assert trace.dt == 0.01
    assert np.abs(trace.column("u_thrust") - np.sin(5 * (t + 1))).max() < 1e-3
    assert np.abs(trace.column("y_height") - np.cos(5 * (t + 1))).max() < 1e-3
    with pytest.raises(BadInput, match=r"times of their own; expected a mapping file .*; it has position\.z, thrust\.force$"):
        open_file(path).traces()
    document = init_files(path, tmp_path, Answers(outputs=["position.z"], units={"thrust.force": "N", "position.z": "m"}))
    (trace,) = open_file(path, Naming.of(Path(document["mapping"]))).traces()
    assert [(c.name, c.unit) for c in trace.channels] == [("u_thrust_force", "N"), ("y_position_z", "m")]
    other = text(tmp_path / "o.toml", "[signals]\nu_thrust = 'thrust.power'\n")
    with pytest.raises(BadInput, match=r"no 'thrust.power', which is to be u_thrust; .* position \(z\), thrust \(force\)"):
        open_file(path, Naming.of(other)).traces()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("time,u\n25.10.2026 00:59:55.000,1\n25.10.2026 00:59:55.010,2\n", "holds '25.10.2026 00:59:55.000'; expected a number of seconds, or a time such as 2026-11-21"),
        ("time,u\n10/25/2026 12:59:55.000000 AM,1\n10/25/2026 12:59:55.010000 AM,2\n", "or a time such as 2026-11-21"),
        ("# logger,\n# 100 Hz,\nt,u\n0,1\n0.1,2\n", "no comment or line of units may come before the numbers"),
        ("t,u\ns,V\n0,1\n0.1,2\n", "row 1 holds 's'; expected a number; the first line has to hold the names of columns"),
        ("t,u\n0,1\n0.1,x\n", "row 2 holds 'x'; expected a number$"),
    ],
)
def test_what_is_no_number_says_what_is_expected(tmp_path, text, expected):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(BadInput, match=expected):
        read_columns(tmp_path / "log.csv")


@pytest.mark.parametrize("time", ["t", "t_ms", "Zeit", "Zeit_ms"])
def test_a_gap_divides_a_table_without_a_mapping_too(tmp_path, time):
    """Each side is a recording of its own, with the numbers as they are."""
    k = np.concatenate([np.arange(80), np.arange(200, 320), np.arange(400, 420)])
    t, u, y = 0.004 * k, np.sin(0.3 * k), np.cos(0.3 * k)
    rows = "".join(f"{1000 * a if 'ms' in time else a:.3f},{float(b)!r},{float(c)!r},7\n" for a, b, c in zip(t, u, y, strict=True))
    (tmp_path / "run.csv").write_text(f"{time},left,place,rest\n{rows}")
    pairs = {"left": "u_left", "place": "y_height", "rest": "", **({time: time.replace("Zeit", "t")} if "Zeit" in time else {})}
    pieces = open_file(tmp_path / "run.csv", Naming(None, pairs)).traces(MODEL)
    assert [c.name for c in pieces[0].channels] == ["u_left", "y_height"]
    with pytest.raises(BadInput, match=r"run\.csv: column 'left' has no role; .* let afdsvc init write a mapping file"):
        open_file(tmp_path / "run.csv", Naming(None, {k: v for k, v in pairs.items() if k != "left"})).traces()
    assert [(len(p), round(p.t0, 6), p.dt) for p in pieces] == [(80, 0.0, 0.004), (120, 0.8, 0.004)]
    assert np.array_equal(pieces[1].column("u_left"), u[80:200])
    assert pieces[0].channels[1].unit == next(v.unit for v in MODEL.outputs if v.name == "height")
    notes = pieces[0].notes["prepared"]
    assert "2 gaps longer than 1.5 sample times" in notes
    assert "20 samples in all" in notes


def test_a_folder_names_the_files_in_it(tmp_path):
    (tmp_path / "run").mkdir()
    with pytest.raises(BadInput, match=r"is a folder; expected a file, such as one in it \(it is empty\)"):
        opened(tmp_path / "run")
    (tmp_path / "run" / "run.db3").touch()
    with pytest.raises(BadInput, match=r"such as one in it \(run.db3\)"):
        opened(tmp_path / "run")


def test_objects_of_python_are_not_read(tmp_path):
    np.savez(tmp_path / "objects.npz", t=np.arange(3.0), u_x=np.array([1, "a", None], dtype=object))
    with pytest.raises(BadInput, match=r"not a readable \.npz file: it holds Python objects; expected arrays of numbers$"):
        read_columns(tmp_path / "objects.npz")
