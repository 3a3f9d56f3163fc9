"""Estimated severities of detected gain faults on the ten drawn machines: detected share, bias and coverage, plain and conditional.

    nice -n 10 python -m benchmarks.detection.severities [--machines N] [--bursts N] [--seed N]

The cut is the estimate moved by the margin of the statistic, which takes the detected fault for the one with the largest statistic.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.statistics.conditional_severity import severity_at
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

SEVERITIES = (-0.02, -0.05, -0.1, -0.3)
HALF = 1.959964  # standard deviations on each side of a 95 % interval


def main() -> None:
    """Simulate, judge and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name, default in (("machines", 10), ("bursts", 5), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    played: dict[tuple[str, float], int] = defaultdict(int)
    rows: dict[tuple[str, float], list[tuple[float, ...]]] = defaultdict(list)
    for machine in machines()[: asked.machines]:
        problem, m = problem_of(machine, FalseAlarms(1e-2)), machine.shape[1]
        size, rate = float(machine.spread()[1].max()), 2 * np.pi / (2000 * machine.dt)
        lines = tuple(Line(i, rate * (70 + 22 * i + 124 * k), 8 * size) for i in range(m) for k in range(2))
        burst = Burst("b", m, 2000, 100, lines, settle=100)
        detector = load().get("detectors", "regression").design(problem, {})
        for fault in problem.fault_names:
            for true in SEVERITIES:
                key = ("actuator" if fault[0] == "a" else "sensor", true)
                for seed in range(asked.bursts):
                    played[key] += 1
                    try:
                        e = judged(machine, problem, detector, burst, 1000 * asked.seed + seed, {fault: true})
                    except ValueError as why:  # counted as played and not detected
                        print(f"no decision: {machine.name}, {fault} at {100 * true:g} %, burst {seed}: {why}", flush=True)
                        continue
                    if e.detected and e.fault == fault and e.severity is not None:
                        x, sd = e.severity.value, e.severity.sd
                        low, mid, high = (severity_at(p, x, sd, x + (e.statistic - e.threshold) * sd) for p in (0.975, 0.5, 0.025))
                        rows[key].append((x - true, abs(x - true) <= HALF * sd, mid - true, low <= true <= high))
    print("fault severity bursts detected | mean and median error, coverage: plain | conditional")
    for key, n in sorted(played.items()):
        r = np.array(rows[key], dtype=float).reshape(-1, 4)
        mean, median = (f(r, axis=0) if len(r) else np.full(4, np.nan) for f in (np.mean, np.median))
        print(
            f"{key[0]:8s} {100 * key[1]:+4.0f} % {n:5d} {len(r) / n:5.2f} | {mean[0]:+.4f} {median[0]:+.4f} {mean[1]:.2f} | "
            f"{mean[2]:+.4f} {median[2]:+.4f} {mean[3]:.2f}"
        )
    print(f"{time.process_time():.0f} s of processor")


if __name__ == "__main__":
    main()
