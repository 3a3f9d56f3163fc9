"""`afdsvc check` from files: one document, a page, a picture in the terminal, and exit code 2 where nothing fits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from afdsvc.cli import app

MOTOR = """
name = "motor"
time = "continuous"
inputs = [{name = "voltage", unit = "V"}]
outputs = [{name = "speed", unit = "rad/s"}]
num = [12.0]
den = [0.08, 1]
"""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-5, 5, 300), 20)
    y, pole = np.zeros(len(u)), np.exp(-5e-3 / 0.08)
    for k in range(len(u) - 1):
        y[k + 1] = pole * y[k] + 12 * (1 - pole) * u[k]
    y += 0.1 * rng.standard_normal(len(u))
    (tmp_path / "motor.toml").write_text(MOTOR)
    for name, sign in (("good", 1), ("turned", -1)):
        rows = "".join(f"{5 * k},{a!r},{sign * b!r}\n" for k, (a, b) in enumerate(zip(u.tolist(), y.tolist(), strict=True)))
        (tmp_path / f"{name}.csv").write_text(f"t_ms,u_voltage,y_speed\n{rows}")
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_first_command_on_a_terminal_says_that_it_compiles_and_later_ones_do_not(tmp_path):
    def said() -> str:
        ours, theirs = os.openpty()
        subprocess.run([sys.executable, "-m", "afdsvc", "check"], stderr=theirs, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, check=False)
        os.close(theirs)
        text = os.read(ours, 4096).decode()
        os.close(ours)
        return text

    done = subprocess.run([sys.executable, "-m", "afdsvc", "check"], capture_output=True, text=True, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, check=False)
    assert "compiled" not in done.stderr  # no terminal: others may read it
    assert "compiled first, once on this computer" in said()
    (tmp_path / "loop.nbi").touch()
    assert "compiled" not in said()


def test_check_of_files(files: Path):
    done = CliRunner().invoke(app, ["check", str(files / "motor.toml"), str(files / "good.csv"), "--json"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["outputs"]["speed"]["r2"] > 0.99
    assert document["data"] == ["good.csv: t is t_ms, converted to s"]
    page = Path(document["report"]).read_text()
    assert "<svg" in page
    assert "coulomb_friction" in page


def test_a_picture_in_the_terminal_and_a_refusal(files: Path):
    done = CliRunner().invoke(app, ["check", str(files / "motor.toml"), str(files / "turned.csv"), "-o", str(files / "page.html")])
    assert done.exit_code == 2
    assert "stops  units: y_speed is of the opposite sign" in done.output
    assert "· measured  + simulated  # both" in done.output
    assert (files / "page.html").exists()
