"""Severities of detected gain faults on the ten drawn machines: detected share, bias and coverage, plain and given the detection.

    python -m benchmarks.detection.severities --out COUNTS.csv [--only MACHINE ..] [--bursts N] [--seed N]
    python -m benchmarks.detection.severities --page COUNTS.csv

The amplitude of every burst is chosen so that each severity is detected in about half of them: there the selection matters most. Counts of
several seeds add up. ``N`` bursts for each machine and each of two pairs of detectors, spread over its faults and severities.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, Detector, FalseAlarms
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.thresholds.regressor_information import noise_driven
from afdsvc.excite.expected_detection import burst_detection
from afdsvc.lti.statespace import Array
from afdsvc.plugins.manager import load
from benchmarks.detection.counting import exact
from benchmarks.detection.judged import quiet, shown
from benchmarks.detection.truth import TrueMachine, machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

SEVERITIES = (-0.02, -0.05, -0.1, -0.3)
PAIRS = (("matched_filter", "fault_curves"), ("regression", "iterated_regression"))  # of equal standard errors: shown the same bursts
HALF = 1.959964  # standard deviations on each side of a 95 % interval
SAMPLES = 2000
DEFLECTION = 3.5  # standard deviations that the fault moves its severity's estimate
COLUMNS = ("machine", "detector", "severity", "played", "reported", "plain_holds", "holds", "plain_error", "error")
Row = Mapping[str, str | float]


def burst_for(machine: TrueMachine, problem: DetectionProblem, fault: str, severity: float, passive: float) -> Burst | None:
    """Return the burst of two lines per input under which the severity's estimate lies at `DEFLECTION` standard errors; ``passive`` is the
    information in the loop's own noise. None where the loop is lost or no burst shows the fault."""
    m, rate = machine.shape[1], 2 * np.pi / (SAMPLES * machine.dt)

    def burst(amplitude: float) -> Burst:
        lines = tuple(Line(i, rate * (70 + 22 * i + 124 * j), amplitude) for i in range(m) for j in range(2))
        return Burst("b", m, SAMPLES, 100, lines, settle=100)

    size = float(machine.spread()[1].max())
    sd = burst_detection(problem, burst(size)).deviation(fault, severity) if reachable(problem)[fault][0] < severity else np.inf
    wanted = (DEFLECTION / severity) ** 2
    return burst(size * sd * max(wanted - passive, 0.01 * wanted) ** 0.5) if np.isfinite(sd) else None


def counted(machine: TrueMachine, bursts: int, seed: int) -> Iterator[Row]:
    """Yield a row for every pair of detectors and severity."""
    problem = problem_of(machine, FalseAlarms(1e-3))
    each = -(-bursts // (len(problem.fault_names) * len(SEVERITIES)))
    in_noise = noise_driven(problem).passive * SAMPLES
    for kinds in PAIRS:
        passive = in_noise if "regression" in kinds else np.zeros_like(in_noise)
        detectors = [load().get("detectors", kind).design(problem, {}) for kind in kinds]
        for severity in SEVERITIES:
            rows = [
                _played(machine, problem, detectors, {fault: severity}, burst_for(machine, problem, fault, severity, passive[i]), each, [seed, i, round(-100 * severity)])
                for i, fault in enumerate(problem.fault_names)
            ]
            for kind, own in zip(kinds, np.concatenate(rows, axis=1), strict=True):
                found = own[np.isfinite(own[:, 0])]
                errors = np.median(found[:, [0, 2]], axis=0).tolist() if len(found) else [np.nan, np.nan]
                yield dict(zip(COLUMNS, (machine.name, kind, severity, len(own), len(found), *found[:, [1, 3]].sum(axis=0).astype(int).tolist(), *errors), strict=True))


def _played(
    machine: TrueMachine, problem: DetectionProblem, detectors: Sequence[Detector], truth: Mapping[str, float], burst: Burst | None, bursts: int,
    seed: Sequence[int],
) -> Array:
    """Return ``(detectors, bursts, 4)``, nan where the fault was not detected, not the likeliest, or no interval was reported.

    Columns: error of the plain severity, whether its interval holds the truth, error of the reported one, whether its interval does.
    """
    ((fault, severity),) = truth.items()
    rows = np.full((len(detectors), bursts if burst else 0, 4), np.nan)
    for k in range(rows.shape[1]):
        run = machine.run(np.random.default_rng([*seed, k]), alpha_of(burst, machine.dt, quiet(problem)), loss_of(problem, dict(truth)))
        for i, decisions in enumerate(shown(problem, detectors, run, burst)):
            e = decisions[-1]
            if e.severity and e.severity.low is not None and max(e.weights, key=lambda n: e.weights[n]) == fault:
                x, sd, s = e.parts[f"severity.{fault}"], e.parts[f"sd.{fault}"], e.severity
                rows[i, k] = [x - severity, abs(x - severity) <= HALF * sd, s.value - severity, s.low <= severity <= s.high]
    return rows


def page(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the tables by detector and machine, and by detector and severity."""
    tables = []
    for key in ("machine", "severity"):
        lines = [f"| detector | {key} | reported | median error, plain | reported | coverage, plain | reported (99 % interval) |", "|---|---|---|---|---|---|---|"]
        sums: dict[tuple[str, str], list[Mapping[str, str]]] = defaultdict(list)
        for row in rows:
            sums[row["detector"], row[key]].append(row)
        tables.append("\n".join([*lines, *(f"| `{detector}` | {name} | {_line(found)} |" for (detector, name), found in sorted(sums.items(), key=lambda s: s[0][0]))]))
    return "\n\n".join(tables)


def _line(rows: Sequence[Mapping[str, str]]) -> str:
    played, n, plain, holds = (sum(int(row[c]) for row in rows) for c in ("played", "reported", "plain_holds", "holds"))
    if not n:
        return f"0 of {played} | | | |"
    errors = [sum(int(row["reported"]) * float(row[c]) for row in rows if int(row["reported"])) / n for c in ("plain_error", "error")]
    return f"{n:,} of {played:,} | {errors[0]:+.4f} | {errors[1]:+.4f} | {plain / n:.3f} | {exact(holds, n, 0.99)}"


def main() -> None:
    """Simulate and judge, or print the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--page", type=Path)
    for name, default in (("bursts", 900), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--only", type=int, nargs="*", default=range(10), help="machines by number")
    asked = parser.parse_args()
    if asked.page:
        with asked.page.open() as stream:
            print(page(list(csv.DictReader(stream))))
        return
    for machine in (machines()[i] for i in asked.only):
        for row in counted(machine, asked.bursts, asked.seed):
            fresh = not asked.out.exists()
            with asked.out.open("a", newline="") as stream:
                writer = csv.DictWriter(stream, COLUMNS)
                if fresh:
                    writer.writeheader()
                writer.writerow(row)


if __name__ == "__main__":
    main()
