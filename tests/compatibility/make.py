"""Make the files of 09e6b58 anew, with the code of that commit: PYTHONPATH=CHECKOUT python tests/compatibility/make.py

With ``--documents`` only what the commands answer: run it on your own checkout after a change that is meant to change an answer.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
from conftest import AFDSVC, FILES, HERE, SHIPPED, laid_out, libraries, run

DT, SAMPLES, SOFT, HARDENING = 2e-3, 1500, 8e3, 3e3


def table(path: Path, seed: int, stiffness: float = 1e4, cubic: float = 0.0) -> None:
    """Write a recording of the axis of stated.toml with another stiffness, or one that grows with the deflection."""
    rng, x, h = np.random.default_rng(seed), np.zeros(2), DT / 4
    t, y = np.arange(SAMPLES) * DT, np.empty(SAMPLES)
    u = 0.6 * sum(np.cos(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) for f in (2, 4, 6, 10, 14, 18, 24, 30, 38, 46))

    def rate(x: np.ndarray, force: float) -> np.ndarray:
        return np.array([x[1], -stiffness * x[0] - 80 * x[1] + 1e4 * force - cubic * x[0] ** 3])

    for k, force in enumerate(u):
        y[k] = x[0]
        for _ in range(4):
            a = rate(x, force)
            b = rate(x + h / 2 * a, force)
            c = rate(x + h / 2 * b, force)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, force))
    data = np.column_stack([t, u, y + 0.01 * rng.standard_normal(SAMPLES)])
    np.savetxt(path, data, delimiter=",", header="t,u_force,y_position", comments="", fmt="%.6g")


def logged() -> None:
    """Write the first samples of run.csv as a logger has them: other names, other units, a column nobody asked for."""
    t, u, y = np.loadtxt(FILES / "run.csv", delimiter=",", skiprows=1, max_rows=200).T
    data = np.column_stack([1e3 * t, u / 2.5e-3, 1e3 * y, 0 * t])
    np.savetxt(FILES / "foreign.csv", data, delimiter=",", header="Time,Current,Pos,Note", comments="", fmt="%.6g")


def tables_and_models() -> None:
    """Make the tables, and from them the models `explain` and `identify` write."""
    for name, seed in (("run", 1), ("held", 2)):
        table(FILES / f"{name}.csv", seed, cubic=HARDENING)
        table(FILES / f"{name}_soft.csv", seed, stiffness=SOFT)
    logged()
    for kind, data in (("improved", ""), ("parameter", "_soft")):
        with tempfile.TemporaryDirectory() as folder:
            run(f"explain stated.toml run{data}.csv --holdout held{data}.csv --out {folder}", FILES)
            (FILES / kind).mkdir(exist_ok=True)
            for made in Path(folder).glob("MODEL.*"):
                shutil.copy(made, FILES / kind)
    run("identify stated.toml run.csv --holdout held.csv --out identified.toml", FILES)
    (FILES / "identified.html").unlink()


def recordings() -> None:
    """Import a table; then run service and rig for seven seconds with one burst, and keep what is recorded."""
    (FILES / "imported.mcap").unlink(missing_ok=True)
    run("import run.csv --out imported.mcap --model plain.toml", FILES)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("recorded.toml", "stated.toml"):
            shutil.copy(FILES / file, folder)
        service = subprocess.Popen([*AFDSVC, "serve", "recorded.toml"], cwd=folder)
        time.sleep(15)
        run("rig recorded.toml --machine axis --seconds 7", folder)
        time.sleep(2)
        service.send_signal(signal.SIGTERM)
        service.wait(30)
        (made,) = (folder / "out").glob("*.mcap")
        shutil.copy(made, FILES / "recording.mcap")


def documents() -> None:
    """Keep what each command answers, and the evidence of the shipped recordings."""
    (FILES / "documents").mkdir(exist_ok=True)
    for name, case in tomllib.loads((HERE / "commands.toml").read_text()).items():
        with tempfile.TemporaryDirectory() as folder:
            keep(f"documents/{name}.json", json.loads(run(f"{case['run']} --json", laid_out(Path(folder) / "files"))))
    names = " ".join(sorted(path.name for path in SHIPPED.glob("*.mcap")))
    keep("evidence.json", json.loads(run(f"diagnose {names} --json", SHIPPED)))
    keep("libraries.json", libraries())


def keep(name: str, document: object) -> None:
    """Write a document; every number has the digits that give it back to the last bit."""
    (FILES / name).write_text(json.dumps(document, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    if "--documents" not in sys.argv:
        tables_and_models()
        recordings()
    documents()
