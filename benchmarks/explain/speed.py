"""Time and memory of `explain` on 10 s at 5 kHz of a machine with two inputs and two outputs, the whole library offered.

    python benchmarks/explain/speed.py

Two coupled axes, one on a spring that hardens, under random-phase multisines; white noise of 1 % on both readings. The limits are 30 s on two
cores, so 60 s of processor time, and 1.5 GB.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import cont2discrete

SECONDS, PROCESSOR, MEMORY = 30.0, 60.0, 1.5e9
DT, N, SUBSTEPS = 2e-4, 50_000, 4
STIFFNESS, DAMPING, DRIVE, HARDENING = np.array([[1.6e5, -2e4], [-2e4, 3e5]]), np.diag([35.0, 40.0]), np.diag([900.0, 1100.0]), 1e8
A = np.block([[np.zeros((2, 2)), np.eye(2)], [-STIFFNESS, -DAMPING]])
B = np.vstack([np.zeros((2, 2)), DRIVE])
Array = np.ndarray


def recording(seed: int) -> Array:
    """Return time, inputs and outputs as columns, ``(N, 5)``."""
    rng, t = np.random.default_rng(seed), np.arange(N) * DT
    lines = [np.arange(1 + j, 400, 2) for j in range(2)]
    u = np.column_stack([sum(np.cos(2 * np.pi * f * t + p) for f, p in zip(lf, rng.uniform(0, 2 * np.pi, len(lf)), strict=True)) for lf in lines])
    u /= u.std(0)
    force = np.array([[0.0], [0.0], [1.0], [0.0]])
    Ad, Bd, *_ = cont2discrete((A, np.hstack([B, force]), np.eye(4), np.zeros((4, 3))), DT / SUBSTEPS)
    x, y = np.zeros(4), np.empty((N, 2))
    for k in range(N):
        y[k] = x[:2]
        for _ in range(SUBSTEPS):
            x = Ad @ x + Bd @ np.array([*u[k], -HARDENING * x[0] ** 3])
    return np.column_stack([t, u, y + 0.01 * y.std(0) * rng.standard_normal(y.shape)])


def write(folder: Path) -> None:
    """Write two recordings and the model without the hardening spring."""
    for name, seed in (("train", 1), ("held", 2)):
        np.savetxt(folder / f"{name}.csv", recording(seed), "%.8g", ",", header="t,u_f1,u_f2,y_q1,y_q2", comments="")
    rate = [f'{{name="v{j}", unit="m/s", rate_of="q{j}"}}' for j in (1, 2)]
    (folder / "model.toml").write_text(
        'name = "two axes"\ntime = "continuous"\ninputs = [{name="f1", unit="N"}, {name="f2", unit="N"}]\n'
        'outputs = [{name="q1", unit="m"}, {name="q2", unit="m"}]\n'
        f'states = [{{name="q1", unit="m"}}, {{name="q2", unit="m"}}, {", ".join(rate)}]\n'
        f"A = {A.tolist()}\nB = {B.tolist()}\nC = {np.eye(2, 4).tolist()}\n[uncertainty]\nrelative = 0.05\n"
    )


def main() -> None:
    """Explain them with the command line and print the shares of the limits."""
    with TemporaryDirectory() as where:
        folder = Path(where)
        write(folder)
        command = [sys.executable, "-m", "afdsvc", "explain", "model.toml", "train.csv", "--holdout", "held.csv"]
        subprocess.run([*command[:3], "check", *command[4:6]], cwd=folder, check=True, capture_output=True)  # compiles once
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(next(line for line in done.stdout.splitlines() if "force on" in line)[:110])
    print(f"{'by the clock':<16}{took:8.1f} s, {took / SECONDS:.2f} of {SECONDS:g} s")
    print(f"{'processor':<16}{used:8.1f} s, {used / PROCESSOR:.2f} of {PROCESSOR:g} s")
    print(f"{'memory':<16}{after.ru_maxrss * 1e3 / 1e9:8.2f} GB, {after.ru_maxrss * 1e3 / MEMORY:.2f} of {MEMORY / 1e9:g} GB")


if __name__ == "__main__":
    main()
