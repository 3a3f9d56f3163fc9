"""What people bring, through the commands: their recordings with a mapping, their simulators, and every change reported in the answers."""

import json
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from afdsvc.api.signals import Channel, Trace
from afdsvc.app.batch import Batch, run_batch
from afdsvc.app.diagnose import diagnose_recordings, import_recording
from afdsvc.app.explain import ExplainOptions, explain_files, from_rest
from afdsvc.app.identify import identify_files
from afdsvc.app.rig import run_rig
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.open import Naming
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import read_site
from afdsvc.files.tables.foreign import prepared
from afdsvc.present.html.diagnose_page import diagnose_page

MODEL = """
name = "lag"
time = "discrete"
sample_time = 0.005
inputs = [{name = "force", unit = "N"}]
outputs = [{name = "position", unit = "mm"}]
A = [[0.9]]
B = [[0.1]]
C = [[1.0]]
D = [[0.0]]
[noise]
output_sd = [0.02]
"""
MAPPING = """
[time]
from = "Time"
unit = "ms"
[signals]
u_force = {from = "Current", unit = "mA", factor = 2.5, factor_unit = "N/A"}
y_position = {from = "Pos", unit = "um"}
"""
TOLD = [
    "log.csv: the time of a sample is column Time [ms]",
    "log.csv: not mapped and left out: Note",
    "log.csv: u_force is Current [mA], times 2.5 N/A, converted to N",
    "log.csv: y_position is Pos [um], converted to mm",
]
SENTENCES_ONCE = [said.replace("log.csv:", "log.csv, kept.csv:") for said in TOLD]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with model, mapping and a logger's table at the model's own rate."""
    (tmp_path / "lag.toml").write_text(MODEL)
    (tmp_path / "mapping.toml").write_text(MAPPING)
    write(tmp_path / "log.csv")
    return tmp_path


def write(path: Path, seed: int = 0, keep=slice(None)) -> Path:
    """Write a table of 3000 samples of the model itself, in the logger's units."""
    rng = np.random.default_rng(seed)
    u, y, x = rng.standard_normal(3000), np.empty(3000), 0.0
    for k, force in enumerate(u):
        y[k] = x
        x = 0.9 * x + 0.1 * force
    y += 0.02 * rng.standard_normal(3000)
    columns = np.column_stack([5.0 * np.arange(3000), u / 2.5e-3, 1e3 * y, np.zeros(3000)])
    np.savetxt(path, columns[keep], delimiter=",", header="Time,Current,Pos,Note", comments="", fmt="%.12g")
    return path


def test_diagnose_tells_what_was_done_to_the_data(folder):
    naming = Naming.of(folder / "mapping.toml")
    document = diagnose_recordings([folder / "log.csv"], folder / "lag.toml", calibrate=5.0, naming=naming)
    (found,) = document["recordings"]
    assert found["notes"] == TOLD
    page = diagnose_page(document)
    assert "What was done to the data" in page
    assert "times 2.5 N/A, converted to N" in page
    assert found["verdict"]["fault"] is None
    with pytest.raises(BadInput, match=r"log\.csv.*has no column 't'"):
        diagnose_recordings([folder / "log.csv"], folder / "lag.toml", calibrate=5.0)


def test_a_gap_is_two_recordings_to_diagnose(folder):
    write(folder / "log.csv", keep=np.r_[0:1400, 1500:3000])
    found = diagnose_recordings([folder / "log.csv"], folder / "lag.toml", calibrate=3.0, naming=Naming.of(folder / "mapping.toml"))
    assert [r["recording"].split("/")[-1] for r in found["recordings"]] == ["log.csv (1)", "log.csv (2)"]
    assert all(any("1 gap longer" in note for note in r["notes"]) for r in found["recordings"])


def test_a_batch_takes_a_mapping_and_begins_anew_when_it_changes(folder):
    batch = Batch("identify", folder / "lag.toml", mapping=folder / "mapping.toml")
    done = run_batch(batch, [folder / "log.csv"], folder / "all.parquet", jobs=1)
    row = pq.read_table(folder / "all.parquet").to_pylist()[0]
    assert (done.failed, row["error"], row["value"] > 0.8) == (0, "", True)
    assert set(TOLD) <= set(json.loads(row["document"])["notes"])
    assert run_batch(batch, [folder / "log.csv"], folder / "all.parquet", jobs=1).kept == 1
    (folder / "mapping.toml").write_text(MAPPING.replace("Pos", "Note"))
    assert run_batch(batch, [folder / "log.csv"], folder / "all.parquet", jobs=1).kept == 0


def test_an_import_keeps_gap_units_and_story(folder):
    write(folder / "log.csv", keep=np.r_[0:1400, 1500:3000])
    made = import_recording(folder / "log.csv", folder / "log.mcap", folder / "lag.toml", {}, folder / "mapping.toml")
    assert (made["samples"], made["pieces"], made["notes"][:4]) == (2900, 2, TOLD)
    pieces = Recording(folder / "log.mcap").traces()
    assert [len(p) for p in pieces] == [1400, 1500]
    assert pieces[1].t0 == pytest.approx(7.5)
    assert {c.name: c.unit for c in pieces[0].channels} == {"u_force": "N", "y_position": "mm"}
    (found,) = diagnose_recordings([folder / "log.mcap"], None, calibrate=3.0)["recordings"]
    assert found["notes"] == [f"log.mcap: {said.split(': ', 1)[1]}" for said in made["notes"]]


def test_identify_tells_it_in_document_and_page(folder):
    held = write(folder / "kept.csv", 1)
    naming = Naming.of(folder / "mapping.toml")
    found = identify_files(folder / "lag.toml", [folder / "log.csv"], [held], None, {"method": "subspace", "order": 1}, 0, naming=naming)
    assert set(SENTENCES_ONCE) <= set(found["notes"])
    page = Path(found["report"]).read_text()
    assert "What was done to the data" in page
    assert "converted to mm" in page
    assert found["fit"]["per_output"]["position"]["after"]["r2"] > 0.8


def test_explain_tells_it_in_document_and_page(folder):
    held = write(folder / "kept.csv", 1)
    options = ExplainOptions(folder / "out", jobs=1, mapping_file=folder / "mapping.toml")
    found = explain_files(folder / "lag.toml", [folder / "log.csv"], [held], options)
    assert set(SENTENCES_ONCE) <= set(found["notes"]["data"])
    assert found["verdict"] == "consistent"
    assert "What was done to the data" in Path(found["report"]).read_text()


def test_explain_and_identify_say_what_stands_for_a_simulator(folder):
    """A simulator with the recorded machine's own lag: its linear part is found, compared with it on every recording, and consistent."""
    (folder / "lag.py").write_text("def lag(x, u, dt):\n    x = 0.0 if x is None else 0.9 * x + 0.1 * u[0]\n    return x, [x]\n")
    (folder / "lag.toml").write_text(MODEL.replace("A = [[0.9]]\nB = [[0.1]]\nC = [[1.0]]\nD = [[0.0]]", 'dynamics = "lag.py:lag"'))
    held = write(folder / "kept.csv", 1)
    options = ExplainOptions(folder / "out", allow_code=True, jobs=1, mapping_file=folder / "mapping.toml")
    found = explain_files(folder / "lag.toml", [folder / "log.csv"], [held], options)
    assert found["verdict"] == "consistent"
    assert found["check"][0].startswith("lag.py:lag only steps, so what is worked with is its linear part of order 1")
    assert any(s.startswith("kept.csv, simulated from its inputs and from rest") and "(the two differ by 0 %)" in s for s in found["check"])
    naming = Naming.of(folder / "mapping.toml")
    method = {"method": "subspace", "order": 1}
    found = identify_files(folder / "lag.toml", [folder / "log.csv"], [held], None, method, 0, allow_code=True, naming=naming)
    assert any("lag.py:lag only steps" in note for note in found["notes"])


def test_where_a_simulator_rests_is_taken_off_the_recordings_and_reported(folder):
    (folder / "lag.py").write_text("def lag(x, u, dt):\n    x = 0.0 if x is None else 0.9 * x + 0.1 * u[0]\n    return [x], [x + 7.0]\n".replace("0.9 * x", "0.9 * x[0]"))
    text = MODEL.replace("A = [[0.9]]\nB = [[0.1]]\nC = [[1.0]]\nD = [[0.0]]", 'dynamics = "lag.py:lag"')
    (folder / "lag.toml").write_text(text)
    model = read_model(folder / "lag.toml", allow_code=True)
    trace = Trace("run.csv", 0.005, (Channel("u_force"), Channel("y_position")), np.column_stack([np.ones(60), np.arange(60) + 7.0]))
    (moved,) = from_rest([trace], model)
    np.testing.assert_allclose(moved.values, np.column_stack([np.ones(60), np.arange(60)]), atol=1e-12)
    assert prepared([moved]) == ["run.csv: 7 is taken off y_position, where the simulator rests"]
    assert from_rest([trace], read_model(write_model_of_matrices(folder))) == [trace]


def write_model_of_matrices(folder: Path) -> Path:
    (folder / "matrices.toml").write_text(MODEL)
    return folder / "matrices.toml"


def test_a_recording_in_other_units_than_the_model_is_converted_and_reported(folder):
    import_recording(folder / "log.csv", folder / "log.mcap", folder / "lag.toml", {}, folder / "mapping.toml")
    (folder / "metres.toml").write_text(MODEL.replace('"mm"', '"m"').replace("B = [[0.1]]", "B = [[0.0001]]").replace("0.02", "0.00002"))
    options = {"method": "subspace", "order": 1}
    found = identify_files(folder / "metres.toml", [folder / "log.mcap"], [], folder / "new.toml", options, 0)
    assert "log.mcap: y_position is recorded in mm and converted to m" in found["notes"]
    assert found["fit"]["per_output"]["position"]["before"]["r2"] > 0.8


def test_the_command_line_takes_a_mapping_and_refuses_in_one_sentence(folder):
    command = [sys.executable, "-m", "afdsvc", "import", "log.csv", "-o", "log.mcap", "--json"]
    done = subprocess.run([*command, "--mapping", "mapping.toml", "--model", "lag.toml"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["notes"] == TOLD
    (folder / "mapping.toml").write_text(MAPPING.replace("Current", "Strom"))
    done = subprocess.run([*command, "--mapping", "mapping.toml"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip() == "afdsvc: log.csv: no column 'Strom' to be mapped; it has Time, Current, Pos, Note"


def test_a_rig_whose_simulator_fails_ends_with_its_name(folder, free_port):
    (folder / "lag.py").write_text(
        "def lag(x, u, dt):\n"
        "    x, k = (0.0, 0) if x is None else x\n"
        "    assert k < 400, 'the mesh is torn'\n"
        "    return (0.9 * x + 0.1 * u[0], k + 1), [x]\n"
    )
    (folder / "site.toml").write_text(
        f'site = "hall"\n[transport]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n[[machines]]\nid = "lag"\nmodel = "lag.toml"\n'
        "limits = {output = [6.0], input = [3.0]}\n[machines.driver]\nkind = \"function\"\nunit = \"lag.py:lag\"\n"
    )
    with pytest.raises(BadInput, match=r"simulator .*lag\.py:lag fails: AssertionError: the mesh is torn"):
        run_rig(read_site(folder / "site.toml"), "lag", 5.0, threading.Event())
    assert not [t.name for t in threading.enumerate() if t.name.startswith("connection of")]  # nobody waits for the network
    command = [sys.executable, "-m", "afdsvc", "rig", "site.toml", "--machine", "lag", "--seconds", "5"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "afdsvc: simulator lag.py:lag fails: AssertionError: the mesh is torn"
