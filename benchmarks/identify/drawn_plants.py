"""Fit of automatic `identify` on drawn plants in open loop, beside that of other tools (run with the Python of an environment that holds them).

Plants of 2 to 8 states with 1 or 2 inputs and outputs, every third with feedthrough; random binary inputs held for 2 samples; noise of a
share of each output's deviation, white or AR(1) with pole 0.9. Error: median over frequency of |G - G0| / |G0| (spectral norms), in per cent.

    peers/bin/python benchmarks/identify/drawn_plants.py run peers.csv --tools sippy llsi markov SysIdentPy
    python benchmarks/identify/drawn_plants.py run ours.csv --tools auto
    python benchmarks/identify/drawn_plants.py page ours.csv peers.csv
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from public_sets import PublicSet
from scipy.signal import lfilter

SHARE, POLE = 0.2, 0.9
OMEGA = np.geomspace(0.02, 3.0, 80)
Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def modes(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the transition matrix of modes with these poles."""
    A = np.zeros((2 * len(radius), 2 * len(radius)))
    for k, (r, a) in enumerate(zip(radius, angle, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = r * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return A


def drawn(number: int) -> Matrices:
    """Return A, B, C, D of a plant."""
    rng = np.random.default_rng(number)
    pairs, m, p = rng.integers(1, 5), rng.integers(1, 3), rng.integers(1, 3)
    A = modes(rng.uniform(0.7, 0.97, pairs), rng.uniform(0.1, 2.0, pairs))
    return A, rng.standard_normal((2 * pairs, m)), rng.standard_normal((p, 2 * pairs)), (number % 3 == 0) * rng.standard_normal((p, m))


def recorded(plant: Matrices, number: int, noise: str, samples: int) -> PublicSet:
    """Return inputs and noisy outputs; nothing is held out."""
    (A, B, C, D), rng = plant, np.random.default_rng((number, samples, noise == "white"))
    u = np.repeat(rng.choice([-1.0, 1.0], (samples // 2, B.shape[1])), 2, axis=0)
    x, y = np.zeros(len(A)), np.empty((len(u), len(C)))
    for k in range(len(u)):
        y[k], x = C @ x + D @ u[k], A @ x + B @ u[k]
    e = rng.standard_normal(y.shape)
    e = e if noise == "white" else np.sqrt(1 - POLE**2) * lfilter([1.0], [1.0, -POLE], e, axis=0)
    return PublicSet(u, y + SHARE * y.std(axis=0) * e, u[:0], y[:0])


def response(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Return the frequency response on `OMEGA`."""
    return np.stack([C @ np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B.astype(complex)) + D for w in OMEGA])


def error(found: Matrices, plant: Matrices) -> float:
    """Return the median relative error of the frequency response in per cent."""
    truth = response(*plant)
    gap = np.linalg.norm(response(*found) - truth, 2, axis=(1, 2)) / np.linalg.norm(truth, 2, axis=(1, 2))
    return 100 * float(np.median(gap))


def ours(data: PublicSet, order: int, method: str) -> Matrices:
    """Return what `identify` finds; the order is not given."""
    import afdsvc

    s = afdsvc.identify(data.u, data.y, dt=1.0, groups=0, cross_check=False, method=method).result.fit.system
    return s.A, s.B, s.C, s.D


def run(path: Path, wanted: list[str], plants: int, noises: list[str], samples: list[int]) -> None:
    """Write error, order and seconds of processor time of every tool on every plant, infinite where it failed."""
    from peers import TOOLS

    tools = {f"afdsvc {method}": lambda d, n, m=method: ours(d, n, m) for method in ("auto", "pem")} | TOOLS
    tools = {name: tool for name, tool in tools.items() if any(w in name for w in wanted)}
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["plant", "noise", "samples", "tool", "error", "order", "true order", "seconds"])
        for number, noise, count in itertools.product(range(plants), noises, samples):
            plant = drawn(number)
            data = recorded(plant, number, noise, count)
            for name, tool in tools.items():
                start = time.process_time()
                try:
                    found = tuple(np.asarray(part, dtype=float) for part in tool(data, len(plant[0])))
                    value, order = error(found, plant), len(found[0])
                except Exception as failure:  # a crash is a figure too
                    value, order = np.inf, 0
                    print(f"{number} {noise} {count} {name}: {type(failure).__name__}: {failure}", flush=True)
                table.writerow([number, noise, count, name, f"{value:.4f}", order, len(plant[0]), f"{time.process_time() - start:.3f}"])
                file.flush()


def _ratio(first: np.ndarray, errors: np.ndarray) -> str:
    """Return the geometric mean of the ratios on the same plants, and its bootstrap interval."""
    logs = np.log(first / errors)[np.isfinite(errors)]
    means = np.random.default_rng(0).choice(logs, (4000, len(logs))).mean(axis=1)
    return "{:.2f} ({:.2f} to {:.2f})".format(*np.exp([logs.mean(), *np.percentile(means, [2.5, 97.5])]))


def page(paths: list[Path]) -> None:
    """Print medians of error and seconds of every tool, how often its order is right, how often it failed, and the first tool's errors against its."""
    cells: dict[tuple[str, str], dict[str, list[tuple[float, bool, float]]]] = defaultdict(lambda: defaultdict(list))
    for row in itertools.chain.from_iterable(csv.DictReader(path.open()) for path in paths):
        cells[row["noise"], row["samples"]][row["tool"]].append((float(row["error"]), row["order"] == row["true order"], float(row["seconds"])))
    print("| noise | samples | tool | median error, % | median time, s | order right | failed | first / this, 95 % |\n|---|---:|---|---:|---:|---:|---:|---:|")
    for (noise, samples), tools in cells.items():
        first = np.array(next(iter(tools.values())))[:, 0]
        for tool, found in tools.items():
            errors, right, seconds = np.array(found).T
            print(f"| {noise} | {samples} | {tool} | {np.median(errors):.3g} | {np.median(seconds):.2g} | {int(right.sum())} of {len(found)} | {int(np.isinf(errors).sum())} | {_ratio(first, errors)} |")


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("run", "page"))
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--tools", nargs="+", default=["auto"])
    parser.add_argument("--plants", type=int, default=40)
    parser.add_argument("--noise", nargs="+", default=["white", "coloured"])
    parser.add_argument("--samples", nargs="+", type=int, default=[10_000])
    args = parser.parse_args()
    page(args.files) if args.what == "page" else run(args.files[0], args.tools, args.plants, args.noise, args.samples)
