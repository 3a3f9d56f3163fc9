"""Mapping files: what may stand in them, and tables read through them with every change reported."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.tables.foreign import prepared, read_foreign_columns
from afdsvc.files.tables.mapping import DataMapping, converted, product, read_mapping, same_unit

MODEL = """
name = "axis"
time = "discrete"
sample_time = 0.005
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
A = [[0.9]]
B = [[1.0]]
C = [[1.0]]
D = [[0.0]]
"""
MAPPING = """
[time]
from = "Time_ms"
unit = "ms"
[signals]
aux_temperature = {from = "Temp", unit = "degC", to = "K"}
y_position = {from = "Pos", unit = "inch"}
u_force = {from = "Current", unit = "mA", factor = 2.5, factor_unit = "N/A", offset = -100.0}
"""
N = 2000


def read_foreign(path, mapping, model=None):
    return open_file(path, Naming(mapping)).traces(model)


def columns() -> dict[str, np.ndarray]:
    """Return a logger's columns: 1 kHz, current in mA with an offset of 100, position in inches, and a counter."""
    t = np.arange(N) * 1e-3
    return {
        "Time_ms": 1e6 + 1e3 * t, "Current": 100 + 400 * np.sin(2 * np.pi * 7 * t), "Pos": 0.1 * np.cos(2 * np.pi * 7 * t),
        "Temp": np.full(N, 20.0), "Counter": np.arange(N, dtype=float),
    }  # fmt: skip


def write_csv(path, data):
    np.savetxt(path, np.column_stack(list(data.values())), delimiter=";", header=";".join(data), comments="", fmt="%.17g")


def write_parquet(path, data):
    pq.write_table(pa.table(data), path)


def write_npz(path, data):
    np.savez(path, **data)


def write_mat5(path, data):
    scipy.io.savemat(path, data)


def write_mat73(path, data):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in data.items():
            file[name] = values[None, :]
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


WRITERS = {"a.csv": write_csv, "a.parquet": write_parquet, "a.npz": write_npz, "a.mat": write_mat5, "b.mat": write_mat73}


@pytest.fixture
def mapping(tmp_path) -> DataMapping:
    path = tmp_path / "mapping.toml"
    path.write_text(MAPPING)
    return read_mapping(path)


@pytest.mark.parametrize("name", WRITERS)
def test_a_table_of_any_kind_comes_in_the_models_units(name, mapping, tmp_path):
    data = columns()
    WRITERS[name](tmp_path / name, data)
    model = parse_model(MODEL.replace("0.005", "0.001"), "axis.toml")
    (trace,) = read_foreign(tmp_path / name, mapping, model)
    assert [(c.name, c.unit) for c in trace.channels] == [("u_force", "N"), ("y_position", "mm"), ("aux_temperature", "K")]
    np.testing.assert_allclose(trace.column("u_force"), (data["Current"] - 100) * 1e-3 * 2.5, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(trace.column("y_position"), 25.4 * data["Pos"], rtol=1e-12)
    np.testing.assert_allclose(trace.column("aux_temperature"), 293.15)
    assert trace.dt == pytest.approx(1e-3, rel=1e-12)
    assert prepared([trace]) == [
        f"{name}: the time of a sample is column Time_ms [ms]",
        f"{name}: not mapped and left out: Counter",
        f"{name}: aux_temperature is Temp [degC], converted to K",
        f"{name}: y_position is Pos [inch], converted to mm",
        f"{name}: u_force is Current [mA] plus -100 mA, times 2.5 N/A, converted to N",
    ]


def test_a_discrete_model_asks_for_its_own_rate(mapping, tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    (trace,) = read_foreign(tmp_path / "a.csv", mapping, parse_model(MODEL, "axis.toml"))
    assert trace.dt == 0.005
    t = trace.t  # the table begins at 1000 s
    assert np.abs(trace.column("u_force") - np.sin(2 * np.pi * 7 * (t - 1000))).max() < 5e-4
    assert np.abs(trace.column("y_position") - 2.54 * np.cos(2 * np.pi * 7 * (t - 1000))).max() < 2e-3
    assert "resampled from 1000 Hz (the table) to 200 Hz" in prepared([trace])[-1]
    assert "flat to 80 Hz, 80 dB down from 100 Hz on" in prepared([trace])[-1]


def test_without_a_model_units_stay_and_are_known(mapping, tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    (trace,) = read_foreign(tmp_path / "a.csv", mapping)
    assert {c.name: c.unit for c in trace.channels} == {"u_force": "mA * N / A", "y_position": "inch", "aux_temperature": "K"}


def test_a_signal_without_a_unit_is_said_to_be_taken_as_it_is(tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    mapping = DataMapping.model_validate({"signals": {"u_force": "Current", "aux_x": "Temp"}, "time": {"from": "Time_ms", "unit": "ms"}})
    (trace,) = read_foreign(tmp_path / "a.csv", mapping, parse_model(MODEL.replace("0.005", "0.001"), "axis.toml"))
    assert "a.csv: u_force is Current, taken to be in N" in prepared([trace])
    assert "a.csv: aux_x is Temp, its unit unknown" in prepared([trace])
    other = replace(trace, notes={**trace.notes, "path": "b.csv"})
    assert "a.csv, b.csv: aux_x is Temp, its unit unknown" in prepared([trace, other])  # once, together


def test_a_table_without_time_needs_a_step(tmp_path):
    data = columns()
    del data["Time_ms"]
    write_csv(tmp_path / "a.csv", data)
    signals = {"u_force": "Current"}
    with pytest.raises(BadInput, match=r"has no column 't'; expected key 'time\.from', a column, or 'time\.step' \[s\]"):
        read_foreign(tmp_path / "a.csv", DataMapping.model_validate({"signals": signals}))
    (trace,) = read_foreign(tmp_path / "a.csv", DataMapping.model_validate({"signals": signals, "time": {"step": 0.001}}))
    assert trace.dt == pytest.approx(0.001)
    assert "samples are 0.001 s apart" in prepared([trace])[0]


def test_gaps_of_a_table_become_pieces(mapping, tmp_path):
    data = {name: np.concatenate([v[:700], v[900:]]) for name, v in columns().items()}
    write_csv(tmp_path / "a.csv", data)
    pieces = read_foreign(tmp_path / "a.csv", mapping)
    assert [len(p) for p in pieces] == [700, 1100]
    assert any("1 gap longer than 1.5 sample times" in s for s in prepared(pieces))
    assert len(prepared(pieces)) == len(set(prepared(pieces)))


def test_pairs_of_the_command_line_go_before_the_file(mapping, tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    (trace,) = open_file(tmp_path / "a.csv", Naming(mapping, {"Counter": "aux_counter"})).traces()
    np.testing.assert_array_equal(trace.column("aux_counter"), np.arange(N))


def test_pairs_without_a_file_rename_and_are_reported(tmp_path):
    t = np.arange(100) * 1e-3
    write_csv(tmp_path / "a.csv", {"t": t, "I": t, "y_x": t, "note": t})
    (trace,) = open_file(tmp_path / "a.csv", Naming(None, {"I": "u_x", "note": ""})).traces()
    assert prepared([trace]) == ["a.csv: u_x is I", "a.csv: note is left out"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "key 'signals' maps nothing"),
        ("[signals]\nforce = 'I'", "signal 'force' has no role; expected a name like u_<name>"),
        ("[signals]\nu_x = {unit = 'A'}", r"key 'signals\.u_x\.from' is missing"),
        ("[signals]\nu_x = {from = 'I', unti = 'A'}", r"key 'signals\.u_x\.unti' is not known"),
        ("[signals]\nu_x = {from = 'I', factor = 0}", "0 would leave nothing"),
        ("[signals]\nu_x = {from = 'I', factor = 2, factor_unit = 'N/A'}", "'factor_unit' needs 'unit'"),
        ("[signals]\nu_x = 'I'\n[resample]\ndt = -1", r"key 'resample\.dt' is -1"),
        ("[signals]\nu_x = 'I'\n[resample]\ngap = 1", r"key 'resample\.gap' is 1"),
        ("[signals]\nu_x = 3", r"signals\.u_x"),
        ("signals = 3", "signals"),
        ("[signals", "not a TOML file"),
    ],
)
def test_a_mapping_that_is_wrong_is_refused_by_key(text, said, tmp_path):
    path = tmp_path / "mapping.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match=said) as refusal:
        read_mapping(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("from = \"Current\"", "from = \"Strom\""), r"no column 'Strom' to be mapped; it has Time_ms, Current"),
        (("from = \"Time_ms\"", "from = \"zeit\""), "no column 'zeit' for the time"),
        (('unit = "ms"', 'unit = "mm"'), "time 'Time_ms': 'mm' cannot become 's'"),
        (('unit = "inch"', 'unit = "A"'), "y_position from 'Pos': 'A' cannot become 'mm': their dimensions differ"),
        (('unit = "inch"', 'unit = "inchs/("'), "unit 'inchs/\\(' is not known"),
        (('factor_unit = "N/A"', 'factor_unit = "N"'), "u_force from 'Current'.*cannot become 'N'"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused_by_place(change, said, tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    path = tmp_path / "mapping.toml"
    path.write_text(MAPPING.replace(*change))
    with pytest.raises(BadInput, match=said):
        read_foreign(tmp_path / "a.csv", read_mapping(path), parse_model(MODEL, "axis.toml"))


KNOWN = [
    ("rpm", "rad/s", 2 * np.pi / 60), ("deg", "rad", np.pi / 180), ("inch", "mm", 25.4), ("lbf", "N", 4.4482216152605),
    ("cycle/s", "rad/s", 2 * np.pi), ("um", "m", 1e-6), ("mV", "V", 1e-3), ("bar", "Pa", 1e5), ("kHz", "Hz", 1e3), ("min", "s", 60.0),
]  # fmt: skip


@pytest.mark.parametrize(("source", "target", "factor"), KNOWN)
def test_a_unit_is_converted_by_its_definition(source, target, factor):
    values = np.array([-2.0, 0.0, 1.0, 3.5])
    np.testing.assert_allclose(converted(values, source, target, "here"), factor * values, rtol=1e-14)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1), st.sampled_from(KNOWN))
def test_there_and_back_is_where_it_began(values, units):
    source, target, _ = units
    there = converted(np.array(values), source, target, "here")
    np.testing.assert_allclose(converted(there, target, source, "here"), values, rtol=1e-13, atol=1e-300)


def test_temperatures_are_points_on_a_scale():
    np.testing.assert_allclose(converted(np.array([0.0, 100.0]), "degC", "K", "here"), [273.15, 373.15])


def test_one_unit_in_two_spellings_leaves_every_bit():
    values = np.random.default_rng(0).standard_normal(9)
    for other in ("um", "µm", "micrometer"):
        assert same_unit("um", other, "here")
        assert converted(values, "um", other, "here") is values


def test_a_product_has_the_unit_of_the_product():
    assert same_unit(product("A", "N/A", "here"), "N", "here")


@pytest.mark.parametrize(
    ("source", "target", "said"),
    [
        ("m", "N", "here: 'm' cannot become 'N': their dimensions differ"),
        ("furlongs_of_mine", "m", "here: unit 'furlongs_of_mine' is not known"),
        ("m/(", "m", "unit 'm/\\(' is not known"),
        ("Hz", "rad/s", "differ by 2 pi or not.*'cycle/s'"),
        ("rpm", "Hz", "differ by 2 pi or not"),
    ],
)
def test_what_is_wrong_or_ambiguous_is_refused(source, target, said):
    with pytest.raises(BadInput, match=said):
        converted(np.ones(2), source, target, "here")


def test_a_unit_of_the_model_that_is_none_is_not_blamed_on_the_table(tmp_path):
    (tmp_path / "log.csv").write_text("t,volt,rev\n" + "".join(f"{k / 100},1,{k}\n" for k in range(100)), encoding="utf-8")
    (tmp_path / "map.toml").write_text('[signals]\nu_voltage = {from = "volt", unit = "V"}\ny_speed = {from = "rev", unit = "rpm"}\n', encoding="utf-8")
    model = Model.from_system(([2.0], [0.3, 1]), {"voltage": "V"}, {"speed": "rmp"})
    with pytest.raises(BadInput, match=r"the model's y_speed: unit 'rmp' is not known; expected one such as 'rpm'"):
        read_foreign_columns(tmp_path / "log.csv", read_mapping(tmp_path / "map.toml"), model)
