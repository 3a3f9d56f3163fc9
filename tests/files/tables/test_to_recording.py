"""A table becomes a recording and comes back to the last bit."""

import csv

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import model_text, parse_model
from afdsvc.files.recording.reader import Recording
from afdsvc.files.tables.tables import import_table, read_table

MODEL = parse_model(
    'name="m"\ntime="continuous"\ninputs=[{name="force", unit="N"}]\noutputs=[{name="position", unit="m"}]\n'
    "A=[]\nB=[]\nC=[]\nD=[[1]]",
    "m.toml",
)


def table(path, rows=1234, t0=3.0, dt=0.0016384):
    rng = np.random.default_rng(5)
    lines = [f"{t0 + k * dt:.9g},{rng.normal()!r},{rng.normal() * 1e-9!r}" for k in range(rows)]
    path.write_text("t,u_force,y_position\n" + "\n".join(lines) + "\n")
    return path


def test_to_the_last_bit(tmp_path):
    path = table(tmp_path / "run.csv")
    with path.open() as file:
        rows = [[float(x) for x in row[1:]] for row in list(csv.reader(file))[1:]]
    recording = Recording(import_table(read_table(path), tmp_path / "run.mcap", MODEL))
    [trace] = recording.traces()
    assert trace.values.tobytes() == np.array(rows).tobytes()
    assert (trace.dt, trace.t0) == (0.0016384, 3.0)
    assert [(c.name, c.unit) for c in trace.channels] == [("u_force", "N"), ("y_position", "m")]
    assert recording.loss == ""
    assert recording.metadata["import"]["source"] == "run.csv"


def test_the_model_goes_with_it(tmp_path):
    trace = read_table(table(tmp_path / "run.csv", 100))
    carried = Recording(import_table(trace, tmp_path / "a.mcap", MODEL, machine="axis")).model("axis")
    assert carried.raw == MODEL.raw
    assert model_text(carried) == model_text(MODEL)
    assert Recording(import_table(trace, tmp_path / "b.mcap")).attachments == {}


def test_what_is_not_a_number_stays_so(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,u_a\n0,1\n1,nan\n2,inf\n")
    trace = read_table(path, allow_nan=True)
    [back] = Recording(import_table(trace, tmp_path / "run.mcap")).traces()
    assert back.values.tobytes() == trace.values.tobytes()


def test_slow_tables_have_one_sample_per_block(tmp_path):
    trace = read_table(table(tmp_path / "run.csv", 7, 0.0, 0.5))
    assert [len(b) for b in Recording(import_table(trace, tmp_path / "run.mcap")).blocks()] == [1] * 7


def test_nothing_is_overwritten_and_ids_are_checked(tmp_path):
    trace = read_table(table(tmp_path / "run.csv", 10))
    path = import_table(trace, tmp_path / "run.mcap")
    with pytest.raises(BadInput, match="exists already"):
        import_table(trace, path)
    assert import_table(trace, path, overwrite=True) == path
    with pytest.raises(BadInput, match="machine id"):
        import_table(trace, tmp_path / "b.mcap", machine="a/b")


@pytest.mark.parametrize("name", ["emps/estimation", "emps/pulses", "silverbox/arrow", "two_mass/multisine_A"])
def test_measured_benchmarks_to_the_last_bit(measured, tmp_path, name):
    path = measured / f"{name}.csv"
    with path.open() as file:
        rows = np.array([[float(x) for x in row[1:]] for row in list(csv.reader(file))[1:]])
    [trace] = Recording(import_table(read_table(path), tmp_path / "run.mcap")).traces()
    assert trace.values.tobytes() == rows.tobytes()
