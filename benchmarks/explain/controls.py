"""False names of `afdsvc explain`: the models and the excitation of real machines, their outputs simulated, nothing left out.

    python benchmarks/explain/controls.py FOLDER COUNT SEED [CASE ...]

``FOLDER`` is that of `real_machines.py`. Of every case whose model is stated by matrices ``COUNT`` controls are drawn: the plant with gains that are off by 3 % (standard deviation), disturbances at the inputs and sensor noise, both coloured, of
1 to 40 % of the output. The simulator is scipy's and shares no code with the product. A row per control; the last line counts.
"""

from __future__ import annotations

import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
from numpy.random import Generator
from scipy.signal import cont2discrete, lfilter

from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.errors import BadInput

LONGEST = 6000  # samples of a recording that are kept
CONFIDENT = 0.9


def coloured(n: int, columns: int, rng: Generator) -> np.ndarray:
    """Return stationary noise of unit variance, its correlation time drawn from a sample to a thirtieth of the recording."""
    a = np.exp(-1 / np.exp(rng.uniform(np.log(0.2), np.log(n / 30))))
    x = lfilter([np.sqrt(1 - a * a)], [1, -a], rng.normal(size=(2 * n, columns)), axis=0)
    return x[n:]


def simulated(model: dict, frame: np.ndarray, gain: np.ndarray, process: float, sensor: float, rng: Generator) -> np.ndarray:
    """Return the recording (columns by name) with its outputs simulated: disturbance and noise of these shares of the output's rms."""
    A, B, C, D = (np.atleast_2d(np.array(model[k], float)) for k in "ABCD")
    B, D = B * gain, D * gain
    inputs = [c for c in frame.dtype.names if c.startswith("u_")]
    outputs = [c for c in frame.dtype.names if c.startswith("y_")]
    U = np.column_stack([frame[c] for c in inputs])
    n, dt = len(U), float(np.median(np.diff(frame["t"])))
    if model["time"] == "continuous":
        A, B, C, D, _ = cont2discrete((A, B, C, D), dt)
    y, pushed = _linear(A, B, C, D, U), _linear(A, B, C, D, coloured(n, U.shape[1], rng) * U.std(0))
    size = y.std(0)
    unit = np.maximum(np.sqrt(np.mean(((pushed - pushed.mean(0)) / np.maximum(size, 1e-12)) ** 2)), 1e-12)
    noisy = y + process * pushed / unit + sensor * size * coloured(n, len(outputs), rng)
    made = frame.copy()
    for name, column in zip(outputs, noisy.T, strict=True):
        made[name] = column
    return made


def _linear(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, U: np.ndarray) -> np.ndarray:
    x, X = np.zeros(len(A)), np.empty((len(U), len(A)))
    for k, u in enumerate(U):
        X[k] = x
        x = A @ x + B @ u
    return X @ C.T + U @ D.T


def control(case: Path, out: Path, seed: int) -> tuple[float, float]:
    """Write a control of a case; return its shares of disturbance and noise."""
    rng = np.random.default_rng([seed, *case.name.encode()])
    text = (case / "model.toml").read_text(encoding="utf-8")
    model = tomllib.loads(text)
    (out / "model.toml").write_text(text, encoding="utf-8")
    total, split = np.exp(rng.uniform(np.log(0.01), np.log(0.4))), rng.uniform()
    process, sensor = total * split, total * (1 - split)
    gain = 1 + 0.03 * rng.normal(size=len(model["inputs"]))
    for file in sorted(case.glob("*.csv")):
        frame = np.genfromtxt(file, delimiter=",", names=True)[:LONGEST]
        made = simulated(model, frame, gain, process, sensor, rng)
        np.savetxt(out / file.name, np.array(made.tolist()), delimiter=",", header=",".join(made.dtype.names), comments="")
    return process, sensor


def main(folder: Path, count: int, seed: int, cases: list[str]) -> None:
    """Print a row per control, and the counts."""
    print("| case | seed | disturbance | noise | verdict | named (weight) | seconds |\n|---|---|---|---|---|---|---|", flush=True)
    named = confident = drawn = 0  # a gain that is off may be named: it is
    for number in range(count):
        for case in sorted(p.parent for p in folder.glob("*/model.toml")):
            if (cases and case.name not in cases) or "A" not in tomllib.loads((case / "model.toml").read_text(encoding="utf-8")):
                continue
            with tempfile.TemporaryDirectory() as made:
                out, begin = Path(made), time.perf_counter()
                process, sensor = control(case, out, seed + number)
                try:
                    document = explain_files(
                        out / "model.toml", sorted(out.glob("train*.csv")), sorted(out.glob("holdout*.csv")), ExplainOptions(out=out, jobs=1),
                    )
                except BadInput as error:
                    document = {"verdict": f"refused: {error}", "named": []}
            names = ", ".join(f"{n['physics']} at {n['site']} ({n['weight']:.2f})" for n in document["named"][:3]) or "none"
            false = [n for n in document["named"] if n["physics"] != "parameter_change"]
            drawn, named = drawn + 1, named + bool(false)
            confident += any(n["weight"] >= CONFIDENT for n in false)
            took = time.perf_counter() - begin
            print(f"| {case.name} | {seed + number} | {process:.3f} | {sensor:.3f} | {document['verdict']} | {names} | {took:.0f} |", flush=True)
    print(f"\n{drawn} controls: {named} with a false name, {confident} with a confident one (weight {CONFIDENT} or more).")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
