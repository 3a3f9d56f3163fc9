"""One burst on the turboexpander: every stiffness, actuator and sensor fault at -20 %, and quiet bursts with unbalance.

    python benchmarks/rotor/detect.py --quiet 20
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from loop import record

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.control_plugins import DesignedController
from afdsvc.api.detection import DetectionProblem, FalseAlarms, ResidualBlock
from afdsvc.api.evidence import Evidence
from afdsvc.detect.gate import Gate
from afdsvc.detect.matched import MatchedFilter
from afdsvc.detect.watch import burst_detector
from afdsvc.excite.default import Aim, default_burst
from afdsvc.excite.rehearsal import played
from afdsvc.lti.simulate import simulate
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.plants.amb_turboexpander import NOISE_SD, amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg

BEFORE, AFTER = 3000, 100  # samples around the burst
STEPS = tuple(np.linspace(0, -1, 9)[1:].tolist())


@dataclass(frozen=True)
class Bench:
    """The machine's detection problem, its controller and the burst sized for faults of -20 %."""

    problem: DetectionProblem
    design: DesignedController
    burst: Burst


def bench(rpm: float = 31500) -> Bench:
    """Return the machine at speed with the LQG controller and all twelve faults."""
    plant = amb_turboexpander(rpm)
    G = plant.discrete()
    design = Lqg().design(G, plant.recommended["lqg"])
    residual = innovations(G, plant.output_cov)
    limits = Limits(plant.output_limit, plant.input_limit, 10 * plant.input_limit)
    problem = DetectionProblem(
        "turboexpander", G, plant.faults(), design.interconnection, residual.filter,
        whitening_filter(design.factorisation, plant.output_cov)[0], residual.covariance,
        tuple(v.name for v in plant.outputs), FalseAlarms(1e-3), tuple(v.name for v in plant.inputs), limits=limits,
    )
    return Bench(problem, design, default_burst(problem, limits, aim=Aim(severity=-0.2)))


def one_burst(b: Bench, severities: dict[str, float], seed: int, rpm: float) -> tuple[Evidence, float]:
    """Return what the matched filter says after one burst, and the largest displacement [um]."""
    alpha = played(b.burst, b.problem.plant.dt, BEFORE, AFTER)
    rng = np.random.default_rng(seed)
    run = record(b.problem.augmented.close(severities), b.design.factorisation, alpha, rng, NOISE_SD, rpm)
    r, _ = simulate(b.problem.innovations, np.hstack([run.y, run.u]))
    statistic = MatchedFilter(b.problem, STEPS, orders=(1,))
    detector = burst_detector("matched_filter", b.problem, statistic, Gate(1e-3, 20, 2500), 0.99, 100)
    state, found = detector.start(), []
    edges = [0, BEFORE, BEFORE + b.burst.samples, len(alpha)]
    for first, last in pairwise(edges):
        part, inside = slice(first, last), first == BEFORE
        block = ResidualBlock(
            first, b.problem.plant.dt, r[part], run.beta[part], run.u[part], run.y[part], alpha[part],
            b.burst if inside else None, b.burst.name if inside else "", BEFORE, aux={"angle": run.angle[part, None]},
        )
        state, evidence = detector.step(state, block)
        found += evidence
    return found[0], float(np.abs(run.y).max())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--quiet", type=int, default=20)
    wanted = parser.parse_args()
    machine = bench()
    print([(line.input, round(line.omega), round(line.amplitude, 4)) for line in machine.burst.lines], machine.burst.notes)
    print("fault, statistic, threshold, above it, residual trusted, named, severity, largest displacement [um]; unbalance G2.5 present")
    for number, name in enumerate(machine.problem.fault_names):
        e, peak = one_burst(machine, {name: -0.2}, number, 31500)
        print(name, round(e.statistic, 1), round(e.threshold, 2), e.statistic > e.threshold, e.trustworthy, e.fault, e.severity, round(peak, 1), flush=True)
    alarms, statistics = 0, []
    for seed in range(wanted.quiet):
        e, _ = one_burst(machine, {}, 1000 + seed, 31500)
        alarms, statistics = alarms + (e.statistic > e.threshold), [*statistics, e.statistic]
    print("quiet bursts:", wanted.quiet, "alarms:", alarms, "largest statistic:", max(statistics, default=0.0))
