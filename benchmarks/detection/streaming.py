"""Samples per second and core of the streaming detectors, against reading the same bytes with numpy, in one run.

    python benchmarks/detection/streaming.py [--quick] [--docs]

Per sample means: the samples in the middle of a burst, without the first block (which prepares the burst) and the last (which
decides); what deciding costs is listed by itself. Blocks of 1000 samples of the gas bearing (80 bytes a sample: residual, beta,
inputs, outputs, excitation). Times are CPU times, the best of several passes. ``--docs`` writes docs/reference/detection-streaming.md.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

from afdsvc.api.bursts import Burst, Line  # noqa: E402
from afdsvc.api.detection import DetectionProblem, Detector, ResidualBlock  # noqa: E402
from afdsvc.lti.lft import FaultDirection, augment  # noqa: E402
from afdsvc.lti.statespace import Array  # noqa: E402
from afdsvc.plugins.detectors import afdsvc_detectors  # noqa: E402
from afdsvc.testing.machines import bearing_problem  # noqa: E402

BLOCK = 1000
LENGTHS = (5_000, 50_000, 500_000)
FAULTS = (1, 5, 15, 50)
STREAMING = ("fault_curves", "matched_filter", "regression", "cusum", "published_a0", "chi_square", "limit_check")


@dataclass(frozen=True)
class Cost:
    """Nanoseconds of CPU per sample, and milliseconds to decide."""

    sample: float
    decision: float


def problem(faults: int) -> DetectionProblem:
    """Return the gas bearing with gain faults along so many directions of its two actuators."""
    base = bearing_problem("lqg")
    g, angles = base.plant, np.pi * np.arange(faults) / faults
    ways = []
    for k, a in enumerate(angles):
        v = np.array([[np.cos(a)], [np.sin(a)]])
        ways.append(FaultDirection(f"actuator along {k}", g.B @ v, np.zeros((g.outputs, 1)), np.zeros((1, g.order)), v.T, np.zeros((1, 1))))
    return replace(base, augmented=augment(g, ways))


def burst(samples: int) -> Burst:
    """Return a burst of two lines."""
    lines = (Line(0, 790.0, 1.2), Line(1, 1203.0, 0.9))
    return Burst("long", 2, samples, 250, lines, settle=500)


def blocks(samples: int, playing: Burst | None, limit: int) -> list[ResidualBlock]:
    """Return the first ``limit`` samples and the last block of a record in which ``playing`` begins at once."""
    rng, root = np.random.default_rng(1), np.linalg.cholesky(bearing_problem("lqg").covariance)  # quiet data the gate trusts
    starts = [*range(0, min(limit, samples - BLOCK), BLOCK), samples - BLOCK]
    asked = np.zeros((samples, 2)) if playing is None else playing.play(2e-4)
    out = []
    for k in starts:
        r, beta, u, y = (rng.normal(size=(BLOCK, 2)) for _ in range(4))
        r = r @ root.T
        out.append(ResidualBlock(k, 2e-4, r, beta, u, y, asked[k : k + BLOCK], playing, "long", 0))
    return out


def cost(detector: Detector, samples: int, playing: Burst | None, passes: int, middle: int) -> Cost:
    """Return what a record costs; only ``middle`` samples of its middle are timed, its length is real all the same."""
    record = blocks(samples, playing, middle + BLOCK)
    per_sample, decision = [], []
    for _ in range(passes):
        state, _ = detector.step(detector.start(), record[0])
        started = time.process_time()
        for block in record[1:-1]:
            state, _ = detector.step(state, block)
        per_sample.append((time.process_time() - started) / (BLOCK * (len(record) - 2)))
        started = time.process_time()
        detector.step(state, record[-1])
        decision.append(time.process_time() - started)
    return Cost(min(per_sample) * 1e9, min(decision) * 1e3)


def reading(passes: int, samples: int = 500_000) -> float:
    """Return nanoseconds to read one sample's 80 bytes from a file in memory with numpy, block by block."""
    with tempfile.NamedTemporaryFile() as file:
        np.random.default_rng(0).normal(size=(samples, 10)).tofile(file.name)
        return 1e9 / samples * min(_timed(lambda: _read(file.name)) for _ in range(passes))


def _read(name: str) -> Array:
    with open(name, "rb") as file:
        block = np.fromfile(file, count=10 * BLOCK)
        while len(block):
            last = block
            block = np.fromfile(file, count=10 * BLOCK)
    return last


def _timed(job: Callable[[], object]) -> float:
    started = time.process_time()
    job()
    return time.process_time() - started


def study(quick: bool) -> tuple[list[list[str]], list[list[str]], list[list[str]], float]:
    """Return the tables by length, by faults and by severities, and what reading costs."""
    passes, middle = (2, 3 * BLOCK) if quick else (3, 10 * BLOCK)
    lengths, faults = (LENGTHS[:2], FAULTS[::3]) if quick else (LENGTHS, FAULTS)
    read = reading(passes)
    designs = {d.name: d for d in afdsvc_detectors()}
    by_length = []
    for name in STREAMING:
        detector = designs[name].design(problem(4), {})
        costs = [cost(detector, n, burst(n), passes, min(middle, n - 2 * BLOCK)) for n in lengths]
        by_length.append(_row(name, costs, read))
    windows = [designs["passive_cusum"].design(problem(4), {"gate_window": n}) for n in lengths]
    by_length.append(_row("passive_cusum (window: gate)", [cost(d, 40 * BLOCK, None, passes, middle) for d in windows], read))
    by_faults, by_severities = [], []
    for name in (*STREAMING, "passive_cusum"):
        playing = None if name == "passive_cusum" else burst(LENGTHS[1])
        costs = [cost(designs[name].design(problem(k), {}), LENGTHS[1], playing, passes, middle) for k in faults]
        by_faults.append(_row(name, costs, read))
    for each in (1, 13):
        detector = designs["matched_filter"].design(problem(4), {"severities": each})
        found = cost(detector, LENGTHS[1], burst(LENGTHS[1]), passes, middle)
        by_severities.append([f"{4 * each}", f"{found.sample:.0f}", f"{found.sample / read:.1f}", f"{found.decision:.1f}"])
    return by_length, by_faults, by_severities, read


def _row(name: str, costs: list[Cost], read: float) -> list[str]:
    spread = max(c.sample for c in costs) / min(c.sample for c in costs)
    fastest = min(costs, key=lambda c: c.sample)
    return [
        name, *(f"{c.sample:.0f}" for c in costs), f"{spread:.2f}", f"{1e3 / fastest.sample:.2f}", f"{fastest.sample / read:.1f}",
        " / ".join(f"{c.decision:.1f}" for c in costs),
    ]  # fmt: skip


def text(quick: bool) -> str:
    """Return the page."""
    by_length, by_faults, by_severities, read = study(quick)
    lengths, faults = (LENGTHS[:2], FAULTS[::3]) if quick else (LENGTHS, FAULTS)
    rest = ["largest / smallest", "million samples/s", "times reading", "to decide [ms]"]
    return "\n\n".join([
        "# Streaming detectors: what a sample costs",
        f"Written {datetime.date.today().isoformat()} by `python benchmarks/detection/streaming.py{' --quick' if quick else ''}` "
        f"(Python {platform.python_version()}, {platform.machine()}, one core).",
        (__doc__ or "").split("\n\n")[2].split(" ``--docs``")[0].replace("\n", " "),
        f"Reading the same 80 bytes with numpy: {read:.1f} ns a sample, {1e3 / read:.0f} million samples/s.",
        "## Window length\n\nNanoseconds a sample for bursts of so many samples, four faults. A gate with a short memory tests more often.",
        _table(["detector", *(f"{n:,}" for n in lengths), *rest], by_length),
        "## Number of faults\n\nNanoseconds a sample for so many faults (gain lost along so many directions), bursts of 50,000 samples. "
        "Detectors on lines and energies do not look at faults before the decision. `regression` and the CUSUMs run one filter and one "
        "set of sums for all faults; the CUSUMs look at every hypothesis at the end of a block only (1 ms between bursts, 5 ms or a "
        "fortieth of a burst inside one), which is by how much an alarm may come late.",
        _table(["detector", *(f"{k}" for k in faults), *rest], by_faults),
        "## Number of hypotheses at one number of faults\n\n`matched_filter`, four faults at more and more severities.",
        _table(["hypotheses", "ns a sample", "times reading", "to decide [ms]"], by_severities),
    ]) + "\n"  # fmt: skip


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def main() -> None:
    """Print the page, and write it with ``--docs``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer lengths and passes")
    parser.add_argument("--docs", action="store_true", help="write docs/reference/detection-streaming.md")
    wanted = parser.parse_args()
    page = text(wanted.quick)
    print(page)
    if wanted.docs:
        path = Path(__file__).resolve().parents[2] / "docs" / "reference" / "detection-streaming.md"
        path.write_text(page)


if __name__ == "__main__":
    main()
