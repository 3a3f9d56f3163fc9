"""Severities of detected gain faults on the ten drawn machines: detected share, bias and coverage, plain and given the detection.

    python -m benchmarks.detection.severities [--only MACHINE ..] [--bursts N] [--seed N] [--detector NAME]

The amplitude of every burst is chosen so that each severity is detected in about half of them: there the selection matters most.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.lti.statespace import Array
from afdsvc.plugins.manager import load
from benchmarks.detection.counting import share
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import TrueMachine, machines
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


def counted(machine: TrueMachine, kind: str, severity: float, played: int, seed: int) -> Array:
    """Return one row per burst that was played with a fault of this severity, each fault in turn; nan where it was not detected and named.

    Columns: error of the plain severity, whether its interval holds the truth, error of the reported one, whether its interval does.
    """
    problem = problem_of(machine, FalseAlarms(1e-3))
    detector, rows = load().get("detectors", kind).design(problem, {}), []
    for i, fault in enumerate(problem.fault_names):
        try:
            burst = bursts(machine, problem, fault, severity, detector)
        except (ValueError, KeyError):  # the loop is lost with this fault: no decision
            continue
        for k in range(played if burst else 0):
            e, row = judged(machine, problem, detector, burst, [seed, i, round(-100 * severity), k], {fault: severity}), [np.nan] * 4
            if e.detected and e.severity is not None and max(e.weights, key=lambda n: e.weights[n]) == fault:
                x, sd, s = e.parts[f"severity.{fault}"], e.parts[f"sd.{fault}"], e.severity
                row = [x - severity, abs(x - severity) <= HALF * sd, s.value - severity, s.low <= severity <= s.high]
            rows.append(row)
    return np.array(rows, dtype=float).reshape(-1, 4)


def line(name: str, rows: Array) -> str:
    """Return a line of the table."""
    found = rows[np.isfinite(rows[:, 0])]
    if not len(found):
        return f"| {name} | 0 of {len(rows)} | | | |"
    holds = share(int(found[:, 3].sum()), len(found), 0.99)
    plain, reported = np.median(found[:, [0, 2]], axis=0)
    return f"| {name} | {len(found) / len(rows):.2f} of {len(rows)} | {plain:+.4f} | {reported:+.4f} | {found[:, 1].mean():.3f} | {holds} |"


def main() -> None:
    """Simulate, judge and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name, default in (("bursts", 20), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--only", type=int, nargs="*", default=range(10), help="machines by number")
    parser.add_argument("--detector", default="regression")
    asked, found = parser.parse_args(), {}
    print(f"| {asked.detector} | detected and named | median error, plain | reported | coverage, plain | reported (99 % interval) |\n|---|---|---|---|---|---|")
    for machine in (machines()[i] for i in asked.only):
        for severity in SEVERITIES:
            found[machine.name, severity] = counted(machine, asked.detector, severity, asked.bursts, asked.seed)
        print(line(machine.name, np.vstack([found[machine.name, s] for s in SEVERITIES])), flush=True)
    for severity in SEVERITIES:
        print(line(f"{100 * severity:+.0f} %", np.vstack([rows for (_, s), rows in found.items() if s == severity])))
    print(f"\n{time.process_time():.0f} s of processor")


if __name__ == "__main__":
    main()
