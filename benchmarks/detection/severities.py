"""Severities of detected gain faults on the ten drawn machines: detected share, bias and coverage, plain and given the detection.

    python -m benchmarks.detection.severities [--machines N] [--bursts N] [--seed N] [--detector NAME]

The amplitude of every burst is chosen so that each severity is detected in about half of them: there the selection matters most.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import numpy as np
from scipy.stats import beta

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

SEVERITIES = (-0.02, -0.05, -0.1, -0.3)
HALF = 1.959964  # standard deviations on each side of a 95 % interval
SAMPLES = 2000
DEFLECTION = 3.5  # standard deviations that the fault moves its severity's estimate


def bursts(machine, problem, fault, severity, detector):
    """Return the burst of two lines per input under which the severity's estimate lies at `DEFLECTION` standard errors."""
    m, rate = machine.shape[1], 2 * np.pi / (SAMPLES * machine.dt)
    size = float(machine.spread()[1].max())
    for k in range(12):
        lines = tuple(Line(i, rate * (70 + 22 * i + 124 * j), size * 2.0 ** (k - 3)) for i in range(m) for j in range(2))
        burst = Burst("b", m, SAMPLES, 100, lines, settle=100)
        sd = np.mean([judged(machine, problem, detector, burst, s, {fault: severity}).parts[f"sd.{fault}"] for s in (1, 2)])
        if sd < -severity / DEFLECTION:
            share = sd * DEFLECTION / -severity
            lines = tuple(Line(line.input, line.omega, line.amplitude * share) for line in lines)
            return Burst("b", m, SAMPLES, 100, lines, settle=100)
    return None


def main() -> None:
    """Simulate, judge and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name, default in (("machines", 10), ("bursts", 20), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--detector", default="regression")
    asked = parser.parse_args()
    played: dict[float, int] = defaultdict(int)
    rows: dict[float, list[tuple[float, ...]]] = defaultdict(list)
    for machine in machines()[: asked.machines]:
        problem = problem_of(machine, FalseAlarms(1e-3))
        detector = load().get("detectors", asked.detector).design(problem, {})
        for fault in problem.fault_names:
            for true in SEVERITIES:
                try:
                    burst = bursts(machine, problem, fault, true, detector)
                except (ValueError, KeyError) as why:
                    print(f"no decision: {machine.name}, {fault}: {why}", flush=True)
                    continue
                for seed in range(asked.bursts if burst else 0):
                    played[true] += 1
                    e = judged(machine, problem, detector, burst, 1000 * asked.seed + seed, {fault: true})
                    best = max(e.weights, key=e.weights.get) if e.weights else ""
                    if e.detected and best == fault and e.severity is not None:
                        x, sd, s = e.parts[f"severity.{fault}"], e.parts[f"sd.{fault}"], e.severity
                        rows[true].append((x - true, abs(x - true) <= HALF * sd, s.value - true, s.low <= true <= s.high))
    print(f"{asked.detector}: severity, bursts, detected and named | mean and median error, coverage: plain | given the detection (99 % interval)")
    for key, n in sorted(played.items()):
        r = np.array(rows[key], dtype=float).reshape(-1, 4)
        mean, median = (f(r, axis=0) if len(r) else np.full(4, np.nan) for f in (np.mean, np.median))
        k = int(r[:, 3].sum())
        low, high = beta.ppf(0.005, k, len(r) - k + 1), beta.ppf(0.995, k + 1, len(r) - k)
        print(
            f"{100 * key:+4.0f} % {n:5d} {len(r) / n:5.2f} | {mean[0]:+.4f} {median[0]:+.4f} {mean[1]:.3f} | "
            f"{mean[2]:+.4f} {median[2]:+.4f} {mean[3]:.3f} ({low:.3f} to {high:.3f})"
        )
    print(f"{time.process_time():.0f} s of processor")


if __name__ == "__main__":
    main()
