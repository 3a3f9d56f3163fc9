"""Speed, accuracy and memory of subspace identification against sippy_unipi and nfoursid on the same records.

Run where all three are installed:  python benchmarks/identify/speed.py
One process for every measurement, one BLAS thread; CPU time, so a busy machine does not count.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402

SEEDS, SLOW_SEEDS, NOISE, ORDER = (1, 2, 3, 4, 5, 6, 7, 8), (101, 102, 103, 104, 105), 0.05, 6
LIMIT = 8 * 2**30  # bytes of memory a method may ask for

METHODS = {
    "afdsvc PO-MOESP": ("ours", {"weighting": "po-moesp", "route": "auto"}),
    "afdsvc PO-MOESP, block QR": ("ours", {"weighting": "po-moesp", "route": "qr"}),
    "afdsvc N4SID": ("ours", {"weighting": "n4sid", "route": "auto"}),
    "afdsvc CVA": ("ours", {"weighting": "cva", "route": "auto"}),
    "afdsvc PBSIDopt": ("pbsid", {}),
    "sippy N4SID": ("sippy", {"method": "N4SID"}),
    "sippy MOESP": ("sippy", {"method": "MOESP"}),
    "sippy CVA": ("sippy", {"method": "CVA"}),
    "nfoursid": ("nfoursid", {}),
}


def system(seed):
    """Six states in three damped pairs (poles of modulus 0.85 to 0.97; seeds above 100: 0.97 to 0.99), two inputs, two outputs."""
    rng = np.random.default_rng(seed)
    low, high = (0.97, 0.99) if seed > 100 else (0.85, 0.97)
    A = np.zeros((6, 6))
    for i, (radius, angle) in enumerate(zip(rng.uniform(low, high, 3), np.array([0.35, 1.0, 1.9]) + rng.uniform(-0.2, 0.2, 3), strict=True)):
        c, s = radius * np.cos(angle), radius * np.sin(angle)
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[c, s], [-s, c]]
    return A, rng.standard_normal((6, 2)), rng.standard_normal((2, 6))


def record(seed, samples):
    A, B, C = system(seed)
    rng = np.random.default_rng(1000 + seed)
    u, x, y = rng.standard_normal((samples, 2)), np.zeros(6), np.empty((samples, 2))
    for k in range(samples):
        y[k] = C @ x
        x = A @ x + B @ u[k]
    return u, y + NOISE * y.std(axis=0) * rng.standard_normal(y.shape)


def response(A, B, C, D, omega):
    return np.array([C @ np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B) + D for w in omega])


def errors(seed, A, B, C, D):
    omega = np.linspace(0.01, 3.1, 300)
    truth = response(*system(seed), np.zeros((2, 2)), omega)
    gap = np.linalg.norm(response(A, B, C, D, omega) - truth, 2, axis=(1, 2)) / np.linalg.norm(truth, 2, axis=(1, 2))
    return float(np.median(gap)), float(gap.max())


def ours(u, y, horizon, weighting, route):
    from afdsvc.dataset.arrays import InputOutputData
    from afdsvc.identify.methods.subspace import decompose, realise

    s = realise(decompose([InputOutputData.of(u, y, 1.0)], horizon, weighting, route), ORDER, feedthrough=False).system
    return s.A, s.B, s.C, s.D


def pbsid(u, y, horizon):
    from afdsvc.dataset.arrays import InputOutputData
    from afdsvc.identify.methods.pbsid import decompose_predictor, realise_predictor

    s = realise_predictor(decompose_predictor([InputOutputData.of(u, y, 1.0)], 3 * horizon), ORDER).system
    return s.A, s.B, s.C, s.D


def sippy(u, y, horizon, method):
    from sippy_unipi import system_identification

    s = system_identification(y.T, u.T, method, SS_fixed_order=ORDER, SS_f=horizon, SS_p=horizon)
    return s.A, s.B, s.C, s.D


def nfoursid(u, y, horizon):
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    frame = pd.DataFrame(np.hstack([u, y]), columns=["u0", "u1", "y0", "y1"])
    solver = NFourSID(frame, ["y0", "y1"], ["u0", "u1"], num_block_rows=horizon)
    solver.subspace_identification()
    s, _ = solver.system_identification(rank=ORDER)
    return s.a, s.b, s.c, s.d


def measure(label, seed, samples, horizon):
    kind, settings = METHODS[label]
    run = {"ours": ours, "pbsid": pbsid, "sippy": sippy, "nfoursid": nfoursid}[kind]
    u, y = record(seed, samples)
    run(*record(seed, 2000), horizon, **settings)  # imports and compilation are paid once
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT))
    start, wall = time.process_time(), time.perf_counter()
    found = run(u, y, horizon, **settings)
    cpu, wall = time.process_time() - start, time.perf_counter() - wall
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    median, worst = errors(seed, *map(np.asarray, found))
    print(json.dumps({"cpu": cpu, "wall": wall, "memory": memory / 1024, "median": median, "worst": worst}))


def apart(label, seed, samples, horizon):
    """Run one measurement in a process of its own; None when it fails (memory)."""
    call = [sys.executable, __file__, "--one", label, str(seed), str(samples), str(horizon)]
    root = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(call, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": root}, check=False)
    if done.returncode:
        print(label, samples, done.stderr.strip().splitlines()[-1:], flush=True)
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def cell(label, samples, horizon, seeds=SEEDS):
    found = [apart(label, seed, samples, horizon) for seed in (seeds if label != "nfoursid" else seeds[:1])]
    good = [f for f in found if f is not None]
    return {k: float(np.median([f[k] for f in good])) for k in good[0]} if good else None


def study():
    from page import table, write

    parts = [
        f"Two inputs, two outputs, six states, white inputs, {100 * NOISE:.0f} % output noise, order given; median of {len(SEEDS)} systems "
        "(nfoursid: one). Errors are of the frequency response, relative at each of 300 frequencies. CPU time with one BLAS thread, without "
        f"imports and compilation; memory is what the run added to the process (limit {LIMIT / 2**30:.0f} GB)."
    ]
    for horizon in (20, 40):
        rows, reference = [], {}
        for label in METHODS:
            for samples in (10_000, 70_000):
                found = cell(label, samples, horizon)
                print(horizon, label, samples, found, flush=True)
                if label == "sippy N4SID" and found:
                    reference[samples] = found
                rows.append((label, samples, found))
        lines = [
            [label, f"{samples:,}", *(
                [f"{f['cpu']:.3f}", f"{reference[samples]['cpu'] / f['cpu']:.1f}" if samples in reference else "", f"{f['memory']:.0f}",
                 f"{100 * f['median']:.3f} %", f"{100 * f['worst']:.2f} %"] if f else ["failed: MemoryError", "", "", "", ""]
            )] for label, samples, f in rows
        ]
        parts += [
            f"## Horizon {horizon}",
            table(["method", "samples", "CPU s", "times faster than sippy N4SID", "memory MB", "median error", "worst error"], lines),
        ]
    rows = []
    for label in ("afdsvc PO-MOESP", "afdsvc N4SID", "afdsvc PBSIDopt", "sippy N4SID"):
        for samples in (10_000, 70_000):
            f = cell(label, samples, 20, SLOW_SEEDS)
            rows.append([label, f"{samples:,}", f"{f['cpu']:.3f}", f"{100 * f['median']:.3f} %", f"{100 * f['worst']:.2f} %"])
            print(rows[-1], flush=True)
    parts += [
        "## Lightly damped systems, horizon 20",
        f"Poles of modulus 0.97 to 0.99, time constants of 30 to 100 samples: longer than the horizon. Median of {len(SLOW_SEEDS)} systems.",
        table(["method", "samples", "CPU s", "median error", "worst error"], rows),
    ]
    rows = []
    for samples in (70_000, 280_000, 1_120_000):
        found = cell("afdsvc PO-MOESP", samples, 20)
        rows.append([f"{samples:,}", f"{found['cpu']:.2f}", f"{found['memory']:.0f}", f"{found['memory'] * 2**20 / samples:.0f}", f"{samples * 4 * 8 / 2**20:.0f}"])
        print(rows[-1], flush=True)
    parts += [
        "## Growth with the samples (PO-MOESP, horizon 20)",
        table(["samples", "CPU s", "memory MB", "bytes per sample", "the recording itself, MB"], rows),
        "PBSIDopt looks back three horizons. The fast route of afdsvc builds the cross products of the windows from correlations and falls "
        "back to block QR where the data are too nearly dependent for that; both give the same model to rounding.",
    ]
    write("identification-speed", "Subspace identification: speed, accuracy, memory", "python benchmarks/identify/speed.py", parts)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        measure(sys.argv[2], *map(int, sys.argv[3:]))
    else:
        study()
