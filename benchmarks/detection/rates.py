"""Alarm rates of every shipped detector on every machine, promised one alarm in 10 to 10,000 bursts.

    python benchmarks/detection/rates.py [--quick] [--docs] [--machines KEY ..] [--again DETECTOR ..]

Prints one line per combination; ``--docs`` writes docs/reference/detection-rates.md and the table beside it as CSV. What falls
outside its 99 per cent interval is repeated with an independent seed, and both results are shown.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from rates_baselines import BASELINES, baseline_rates  # noqa: E402
from rates_cases import MACHINES, RATES, RateCase, rate_case  # noqa: E402
from rates_counting import Rate  # noqa: E402
from rates_lines import LINE_DETECTORS, PUBLISHED, line_rate  # noqa: E402
from rates_page import agreement as agreement_text  # noqa: E402
from rates_page import load, write  # noqa: E402
from rates_played import played_rates  # noqa: E402
from rates_real import Agreement, agreement, passive_agreement, record  # noqa: E402
from rates_regression import REGRESSIONS, regression_rates  # noqa: E402
from rates_sequential import cusum_rates, passive_rates  # noqa: E402

from afdsvc.detect.features.regressors import regressors  # noqa: E402

SEED, REPEAT = 1, 2  # declared beforehand: the first run, and the one repetition of what fell outside
ROOT = Path(__file__).resolve().parents[2]
KEPT = "the promise"
ABOVE = "at most the promise"
NONE = "one template's rate, as published"


@dataclass(frozen=True)
class Effort:
    """Numbers of runs of every kind."""

    lines: int
    cusum: int
    passive: int
    healthy: int
    rare: int
    baselines: int
    bank: int
    iterated: int
    real: int


FULL = Effort(60_000, 4000, 1000, 3000, 5000, 4000, 200, 800, 25)
QUICK = Effort(4000, 300, 100, 100, 200, 400, 10, 10, 3)


@dataclass(frozen=True)
class Row:
    """One combination: what was found, and found again where the first result fell outside."""

    machine: str
    detector: str
    promised: float
    promise: str
    found: Rate
    again: Rate | None = None

    def kept(self, found: Rate) -> bool:
        return found.inside(self.promised) if self.promise == KEPT else found.high <= self.promised


def estimates(case: RateCase, effort: Effort, seed: int, only: str = "") -> Iterator[tuple[str, dict[float, Rate]]]:
    """Yield the rates of every detector, or of one only."""
    exact = all(regressors(case.problem).exact)
    for name in (*LINE_DETECTORS, *PUBLISHED):
        if only in ("", name):
            yield name, {r: line_rate(case, name, r, seed, effort.lines if r >= 0.01 else effort.lines // 5) for r in RATES}
    if only in ("", *REGRESSIONS):
        both = regression_rates(case, seed, effort.rare, effort.healthy)
        if not exact:  # one linearisation is not the whole of it: played burst by burst
            both["iterated_regression"] = played_rates(case, "iterated_regression", seed, effort.iterated, effort.iterated)
        yield from both.items()
    if only in ("", "cusum"):
        yield "cusum", cusum_rates(case, seed, effort.cusum)
    if only in ("", "passive_cusum"):
        few = case.burst.samples > 1000  # runs are shorter on the others, and more of them are needed
        yield "passive_cusum", passive_rates(case, seed, effort.passive * (1 if few else 5))
    for name in BASELINES:
        if only in ("", name):
            yield name, baseline_rates(case, name, seed, effort.baselines)
    if only in ("", "model_bank"):
        yield "model_bank", played_rates(case, "model_bank", seed, effort.bank, effort.bank)


def rows(case: RateCase, effort: Effort, only: Sequence[str] = ("",)) -> list[Row]:
    """Return all combinations of one machine, or those of some detectors; those outside are repeated once."""
    out = []
    first = [(name, found) for one in only for name, found in estimates(case, effort, SEED, one) if one in ("", name)]
    for name, found in first:
        promise = NONE if name in PUBLISHED else ABOVE if name == "model_bank" else KEPT
        mine = [Row(case.key, name, rate, promise, found[rate]) for rate in RATES]
        if promise == KEPT and not all(row.kept(row.found) for row in mine):
            again = next(r for n, r in estimates(case, effort, REPEAT, name) if n == name)
            mine = [row if row.kept(row.found) else replace(row, again=again[row.promised]) for row in mine]
        for row in mine:
            print(f"{row.machine:18s} {row.detector:20s} {row.promised:g} {row.found} {row.again or ''}", flush=True)
        out += mine
    return out


def renewed(cases: list[RateCase], effort: Effort, names: list[str], folder: Path) -> None:
    """Count some detectors anew and put them in the place of what the page says of them."""
    known, text, seconds = load(folder)
    started = time.process_time()
    fresh = {(r.machine, r.detector, r.promised): r for case in cases for r in rows(case, effort, names)}
    merged = [
        fresh.get(key) or Row(*key, by_seed[1][0], by_seed[1][1], by_seed[2][1] if 2 in by_seed else None)
        for key, by_seed in known.items()
    ]
    write(merged, text, seconds + time.process_time() - started, folder)


def agreements(case: RateCase, effort: Effort, names: list[str]) -> list[tuple[str, float, Agreement]]:
    """Return how the shipped detectors agree with the short routes, at 1/10 and 1/100."""
    exact = all(regressors(case.problem).exact)
    played = {"model_bank", *(() if exact else ("iterated_regression",))}  # these have no short route
    out = []
    for k, rate in enumerate((0.1, 0.01)):
        shown = record(case, effort.real, SEED + 100 * k)
        for name in names:
            if name not in played:
                short = passive_agreement(case, rate, effort.real // 6 + 1, SEED) if name == "passive_cusum" else None
                out.append((name, rate, short or agreement(case, name, rate, shown)))
    return out


def main() -> None:
    """Count the rates."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few runs: checks that everything works")
    parser.add_argument("--docs", action="store_true", help="write docs/reference/detection-rates.md and .csv")
    parser.add_argument("--again", nargs="*", default=[], metavar="DETECTOR", help="renew these detectors in the page only")
    parser.add_argument("--machines", nargs="*", default=list(MACHINES), choices=list(MACHINES))
    wanted = parser.parse_args()
    effort, started = QUICK if wanted.quick else FULL, time.process_time()
    folder = ROOT / "docs" / "reference"
    if wanted.again:
        renewed([rate_case(key) for key in wanted.machines], effort, wanted.again, folder)
        return
    found: list[Row] = []
    agreed: dict[str, list[tuple[str, float, Agreement]]] = {}
    for key in wanted.machines:
        case, at = rate_case(key), time.process_time()
        found += rows(case, effort)
        agreed[key] = agreements(case, effort, list(dict.fromkeys(r.detector for r in found if r.machine == key)))
        print(f"{case.title}: {time.process_time() - at:.0f} CPU seconds", flush=True)
    if wanted.docs:
        write(found, agreement_text(agreed), time.process_time() - started, folder)


if __name__ == "__main__":
    main()
