"""Code that a file names runs only with permission; a recording's own site never opens a driver or a model file."""

from __future__ import annotations

import py_compile
from hashlib import sha256
from importlib.util import cache_from_source

import numpy as np
import pytest
from typer.testing import CliRunner

from afdsvc.api.signals import Block, Channel
from afdsvc.app import commissioning, ports
from afdsvc.app.design import design_files
from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.app.review import fault_planes
from afdsvc.cli import app
from afdsvc.errors import BadInput
from afdsvc.files.allowed_code import allow
from afdsvc.files.model.model_file import read_model
from afdsvc.files.model.stepped import TRUSTED
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.reader import Recording
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.site import read_site
from afdsvc.plugins.manager import load
from afdsvc.service.clock import FastClock
from afdsvc.wire.codec import encode_block

CODE = """from pathlib import Path
Path(__file__).with_name("ran").touch()
def axis(x, u, dt):
    x = (0.0, 0.0) if x is None else x
    return (x[0] + dt * x[1], x[1] + dt * (u[0] - x[1])), [x[0]]
"""
MODEL = """name = "axis"
time = "discrete"
sample_time = 1e-3
dynamics = "CODE"
inputs = [{name = "force"}]
outputs = [{name = "place"}]
"""
SITE = """site = "lab"
[[machines]]
id = "axis"
model = "MODEL"
output_sd = [0.01]
limits = {output = [6.0], input = [3.0], seconds = 4.0}
[machines.driver]
kind = "function"
unit = "CODE"
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with a simulator's code, a model that names it, and a site that names both."""
    (tmp_path / "evil.py").write_text(CODE)
    code, model = f"{tmp_path}/evil.py:axis", f"{tmp_path}/evil.toml"
    (tmp_path / "evil.toml").write_text(MODEL.replace("CODE", code))
    (tmp_path / "site.toml").write_text(SITE.replace("CODE", code).replace("MODEL", model))
    return tmp_path


def recording(folder, models=None):
    """Return a recording with the folder's site inside."""
    path = folder / "stranger.mcap"
    recorder = Recorder(RecordingSettings(path), Header((folder / "site.toml").read_text(), models or {}, {"site": "lab"}))
    channels = (Channel("u_force"), Channel("y_place"))
    for seq in range(8):
        block = Block("axis", "s1", seq, 250 * seq, 1e-3, 250_000_000 * seq, channels, np.random.default_rng(seq).standard_normal((250, 2)))
        recorder.block(encode_block(block), block)
    recorder.close()
    return path


def test_a_recordings_site_opens_neither_driver_nor_model(folder):
    path = recording(folder)
    with pytest.raises(BadInput, match="not inside the recording; expected --model"):
        diagnose_recordings([path])
    fault_planes(Recording(path), "axis")
    assert not (folder / "ran").exists()


def test_a_model_inside_a_recording_is_not_trusted_where_the_recording_lies(folder, monkeypatch):
    monkeypatch.setenv(TRUSTED, str(folder))
    path = recording(folder, {"axis": (folder / "evil.toml").read_text()})
    with pytest.raises(BadInput, match=r"expected permission to run code: --allow-code.*give it the model as a file \(--model\)$"):
        diagnose_recordings([path])
    assert not (folder / "ran").exists()


def test_a_design_sheet_runs_a_models_code_only_with_permission(folder):
    with pytest.raises(BadInput, match="expected permission to run code: --allow-code"):
        design_files(folder / "site.toml", None, None)
    assert not (folder / "ran").exists()


def test_permission_is_remembered_for_one_file_as_it_was(folder, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    code = folder / "evil.py"
    before = sha256(code.read_bytes()).hexdigest()
    with pytest.raises(BadInput, match=f"Python code .SHA-256 {before}. that would run.*'afdsvc allow-code {code}'"):
        read_model(folder / "evil.toml")
    assert CliRunner().invoke(app, ["allow-code", str(code)]).output == f"{code} may run while its SHA-256 is {before}\n"
    read_model(folder / "evil.toml")
    assert (folder / "ran").exists()
    path = recording(folder, {"axis": (folder / "evil.toml").read_text()})
    with pytest.raises(BadInput, match="expected permission to run code"):  # it is the model inside the recording that asks now
        diagnose_recordings([path])
    code.write_text(CODE + "# changed\n")
    with pytest.raises(BadInput, match="expected permission to run code"):
        read_model(folder / "evil.toml")
    code.write_text(CODE)
    read_model(folder / "evil.toml")
    assert CliRunner().invoke(app, ["allow-code", str(code), "--forget"]).exit_code == 0
    with pytest.raises(BadInput, match="expected permission to run code"):
        read_model(folder / "evil.toml")


def test_compiled_code_beside_a_permitted_file_does_not_run(folder, monkeypatch):
    """Python's own loader prefers a .pyc that says its source is not to be compared with it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    allow(folder / "evil.py")
    (folder / "other.py").write_text(CODE.replace('"ran"', '"other"'))
    compiled = cache_from_source(str(folder / "evil.py"))
    py_compile.compile(str(folder / "other.py"), compiled, dfile=str(folder / "evil.py"), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    read_model(folder / "evil.toml")
    assert (folder / "ran").exists()
    assert not (folder / "other").exists()


def test_a_driver_that_is_user_code_is_opened_only_with_permission(folder):
    machine, plugins = read_site(folder / "site.toml").machine("axis"), load()
    (folder / "evil.toml").write_text(MODEL.replace('dynamics = "CODE"\n', "A = [[0.9]]\nB = [[1.0]]\nC = [[1.0]]\nD = [[0.0]]\n"))
    with pytest.raises(BadInput, match=r"key 'driver.unit' is .*evil.py:axis', Python code .* --allow-code"):
        ports.open_port(commissioning.commission(machine, plugins), "s", FastClock(), plugins)
    assert not (folder / "ran").exists()
    ports.open_port(commissioning.commission(machine, plugins, allow_code=True), "s", FastClock(), plugins).close()
    assert (folder / "ran").exists()


def test_a_models_code_is_diagnosed_with_permission_by_its_linear_part(folder):
    """A lag written as code with its matrices: refused without permission, and with it diagnosed as the matrices are."""
    (folder / "lag.py").write_text(
        "from pathlib import Path\nPath(__file__).with_name('ran').touch()\nclass Lag:\n    linear = ([[0.9]], [[0.1]], [[1.0]], [[0.0]], 1e-3)\n"
        "    def f(self, t, x, u, p):\n        return [0.9 * x[0] + 0.1 * u[0]]\n    def h(self, t, x, u, p):\n        return [x[0]]\nlag = Lag()\n"
    )
    head = MODEL.replace('dynamics = "CODE"\n', "") + 'states = [{name = "x"}]\n'
    (folder / "code.toml").write_text(head + 'dynamics = "lag.py:lag"\n')
    (folder / "matrices.toml").write_text(head + "A = [[0.9]]\nB = [[0.1]]\nC = [[1.0]]\nD = [[0.0]]\n")
    rng, x, rows = np.random.default_rng(0), 0.0, []
    for k, u in enumerate(rng.standard_normal(4000)):
        rows.append((1e-3 * k, u, x + 0.01 * rng.standard_normal()))
        x = 0.9 * x + 0.1 * u
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="t,u_force,y_place", comments="")
    with pytest.raises(BadInput, match="--allow-code"):
        diagnose_recordings([folder / "run.csv"], folder / "code.toml")
    assert not (folder / "ran").exists()
    answers = [diagnose_recordings([folder / "run.csv"], folder / name, allow_code=True)["recordings"][0]["verdict"] for name in ("code.toml", "matrices.toml")]
    assert (folder / "ran").exists()
    assert answers[0] == answers[1]
