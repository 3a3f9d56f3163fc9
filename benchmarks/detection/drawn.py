"""Alarm rates when the model is only roughly right: parameters drawn from their stated uncertainty, rates not above the promise.

    python benchmarks/detection/drawn.py [--quick] [--docs]

Prints one line per combination; ``--docs`` writes docs/reference/detection-drawn.md and the table beside it as CSV.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from drawn_cases import CASES, Doubtful, Machine, Playground  # noqa: E402
from drawn_cusum import cusum_drawn  # noqa: E402
from drawn_judges import Judges  # noqa: E402
from drawn_lines import line_rates, wider  # noqa: E402
from drawn_loss import Loss, losses  # noqa: E402
from drawn_page import write  # noqa: E402
from rates_cases import RATES  # noqa: E402
from rates_counting import Rate, counted, weighted  # noqa: E402
from scipy.special import logsumexp  # noqa: E402

from afdsvc.detect.stability_range import reachable  # noqa: E402
from afdsvc.detect.thresholds.power import tail_point  # noqa: E402
from afdsvc.detect.thresholds.regressor_information import noise_driven  # noqa: E402
from afdsvc.errors import BadInput  # noqa: E402
from afdsvc.lti.statespace import Array  # noqa: E402

SEED = 1
ROOT = Path(__file__).resolve().parents[2]
AIMED = (1e-2, 1e-4)  # tails whose points the deflections of the faults are that rare alarms come from
BAND = 12  # bursts from which the band of the regression's thresholds is taken
COUNTED = 0.01  # rates from here on are counted

Faults = Sequence[Mapping[str, float]]


@dataclass(frozen=True)
class Row:
    """One detector at one promised rate; ``certain``: the same, had the model been taken as exactly known."""

    case: str
    detector: str
    promised: float
    found: Rate
    certain: Rate

    @property
    def not_above(self) -> bool:
        return not self.found.refused and self.found.low <= self.promised


def rows(doubtful: Doubtful, plain: int, rare: int) -> list[Row]:
    """Return the rates of every detector on one case."""
    ground, judges = Playground(doubtful), (Judges(doubtful.case), Judges(doubtful.certain))
    rng = np.random.default_rng([SEED, list(CASES).index(doubtful.case.key)])
    taught = [ground.play(_drawn(doubtful, ground, rng), rng)[0] for _ in range(BAND)]
    for judge in judges:
        judge.learn(taught)
    hits = np.array([_plain(doubtful, ground, judges, rng) for _ in range(plain)])
    faults = _faults(doubtful)
    weights = np.array([_rare(doubtful, ground, judges, faults, rng) for _ in range(rare)])
    out, rarer = list[Row](), tuple(r for r in RATES if r < COUNTED)
    seldom = line_rates(doubtful, rarer, 4 * rare, 20, SEED)
    seldom |= {("cusum", rate): both for rate, both in cusum_drawn(doubtful, rarer, 32 * rare, 5, SEED).items()}
    for i, name in enumerate(judges[0].names):
        for j, rate in enumerate(RATES):
            both = seldom.get((name, rate)) or [
                counted(int(hits[:, k, i, j].sum()), plain) if rate >= COUNTED else weighted(weights[:, k, i, j])
                for k in range(2)
            ]
            out.append(Row(doubtful.case.key, name, rate, *both))
    return out


def _plain(doubtful: Doubtful, ground: Playground, judges: tuple[Judges, Judges], rng: np.random.Generator) -> Array:
    """Return the alarms ``(2, detectors, rates)`` of one burst of a machine as it may be."""
    series, _ = ground.play(_drawn(doubtful, ground, rng), rng)
    return np.array([judge.alarms(series) for judge in judges])


def _drawn(doubtful: Doubtful, ground: Playground, rng: np.random.Generator) -> Machine:
    return ground.machine({name: float(sd * rng.normal()) for name, sd in doubtful.deviations.items()})


def _rare(
    doubtful: Doubtful, ground: Playground, judges: tuple[Judges, Judges], faults: Faults, rng: np.random.Generator
) -> Array:
    """Return the alarms of one burst of a machine that may have a fault, times its weight.

    Deviations come from the stated density or a wider one, in equal parts; given the deviations, records of the machines with
    and without faults are weighted by their likelihoods.
    """
    z, log_prior = wider(rng, len(doubtful.deviations))
    drawn = {name: float(sd * v) for (name, sd), v in zip(doubtful.deviations.items(), z, strict=True)}
    try:
        machines = [ground.machine({**drawn, **fault}) for fault in faults]
    except BadInput:  # so far out that a loop is lost: nothing comes back
        return np.zeros((2, len(Judges.names), len(RATES)))
    series, run = ground.play(machines[int(rng.integers(len(machines)))], rng)
    densities = np.array([machine.log_density(run) for machine in machines])
    weight = np.exp(log_prior + densities[0] - logsumexp(densities) + np.log(len(machines)))
    return np.array([judge.alarms(series) for judge in judges]) * float(weight)


def _faults(doubtful: Doubtful) -> Faults:
    """Return no fault, then two severities of every fault."""
    problem, burst = doubtful.certain.problem, doubtful.case.burst
    noise, out = noise_driven(problem), list[Mapping[str, float]]([{}])
    information = burst.samples * (noise.passive + noise.excited(burst)[0])
    for q in AIMED:
        for i, (fault, (low, _)) in enumerate(reachable(problem).items()):
            out.append({fault: max(-tail_point(q) / float(np.sqrt(information[i])), 0.8 * low)})
    return out


def main() -> None:
    """Count the rates."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few runs: checks that everything works")
    parser.add_argument("--docs", action="store_true", help="write docs/reference/detection-drawn.md and .csv")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    wanted = parser.parse_args()
    plain, rare = (60, 60) if wanted.quick else (1000, 250)
    started, found, lost = time.process_time(), list[Row](), list[Loss]()
    cases = [CASES[key]() for key in wanted.cases]
    for doubtful in cases:
        at = time.process_time()
        found += rows(doubtful, plain, rare)
        lost += losses(doubtful, 200 if wanted.quick else 1000, SEED)
        for row in found:
            if row.case == doubtful.case.key:
                print(f"{row.case:15s} {row.detector:20s} {row.promised:g} {row.found} certain: {row.certain}")
        print(f"{doubtful.case.title}: {time.process_time() - at:.0f} CPU seconds", flush=True)
        if wanted.docs:  # after every machine: a long run that is stopped leaves what it found
            done = [c for c in cases if any(row.case == c.case.key for row in found)]
            write(done, found, lost, time.process_time() - started, ROOT / "docs" / "reference")


if __name__ == "__main__":
    main()
