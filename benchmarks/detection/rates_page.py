"""The page of alarm rates, and its table."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rates_cases import MACHINES, RATES
from rates_counting import FEWEST, Rate

if TYPE_CHECKING:
    from rates import Row
    from rates_real import Agreement

PAGE, TABLE = "detection-rates.md", "detection-rates.csv"
AGREEMENT = "## The detectors as shipped, on the same noise"
COLUMNS = ("machine", "detector", "promised", "promise", "seed", "rate", "low", "high", "method", "runs", "effective", "kept")

INTRO = """\
# Alarm rates: promised and held

Made by `python benchmarks/detection/rates.py --docs` ({seconds:.0f} CPU seconds); every number is in
[detection-rates.csv](detection-rates.csv).

Every detector that ships, on every machine of the comparison, promised one false alarm in 10, 100, 1,000 and 10,000 bursts. A burst
here is short, 2500 samples (600 on the plants sampled at 1 kHz) with 0.4 units of output from every line, because what is only
asymptotically right shows first in short bursts. Machines are healthy, models are right; models that are only roughly right have
[a page of their own](detection-drawn.md). `passive_cusum` decides nothing per burst: its promise is put as so many alarms per stretch as
long as the burst, and found as that stretch over its average run length.

Rates are counted where alarms are frequent and found by importance sampling where they are rare: noise is pushed along the waves of
the faults, and each run weighs as much as it is likelier without the push. Intervals are 99 %. A weighted rate counts with Kish's
effective number of alarms, `(sum w)^2 / sum w^2`, and is refused below {fewest:.0f} of them.

Statistics that are functions of the white residual alone are computed from drawn noise, with the detectors' own directions,
waves, boundaries and thresholds; the regressions and the CUSUM between bursts from a compiled loop of the machine (on all of these
machines the residual is linear in the severity); the bank by playing bursts. The last table shows that the detectors as shipped, gate
included and fed block by block, decide the same on the same noise.
"""

READING = """\
The boundary of `passive_cusum` comes from a simulation of the loop when the detector is designed. `model_bank` promises an upper bound (Ville's inequality) and stays far below it. Its rare cells come from bursts of its own models:
no run that alarms can weigh more than the promise, so few effective alarms do not matter there. `published_a0` and
`published_a_phi` are the thesis' filters as published: their threshold is that of a single template, and what they hold is the rate
of the largest over all phases and outputs, 2 to 4 times as much.
"""


def write(rows: Sequence[Row], agreement: str, seconds: float, folder: Path) -> None:
    """Write page and table into a folder; ``agreement`` is the section about the detectors as shipped."""
    with (folder / TABLE).open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(COLUMNS)
        for row in rows:
            for seed, found in ((1, row.found), (2, row.again)):
                if found is not None:
                    out.writerow(_cells(row, seed, found))
    page = INTRO.format(seconds=seconds, fewest=FEWEST) + "\n" + _summary(rows) + _tables(rows) + READING + agreement
    (folder / PAGE).write_text(page)


def load(folder: Path) -> tuple[dict[tuple[str, str, float], dict[int, tuple[str, Rate]]], str, float]:
    """Return what was written: promise and rate by seed of every machine, detector and promised rate; agreement; CPU seconds."""
    found: dict[tuple[str, str, float], dict[int, tuple[str, Rate]]] = {}
    with (folder / TABLE).open(newline="") as file:
        for c in csv.DictReader(file):
            value, low, high, effective = (float(c[name]) for name in ("rate", "low", "high", "effective"))
            rate = Rate(value, low, high, int(c["runs"]), effective, c["method"] != "counted")
            key = c["machine"], c["detector"], float(c["promised"])
            found.setdefault(key, {})[int(c["seed"])] = c["promise"], rate
    text = (folder / PAGE).read_text()
    seconds = re.search(r"\((\d+) CPU seconds\)", text)
    return found, "\n" + text[text.index(AGREEMENT) :], float(seconds[1]) if seconds else 0.0


def _cells(row: Row, seed: int, found: Rate) -> list[object]:
    numbers = [f"{x:.4g}" for x in (found.value, found.low, found.high)]
    kept = "" if row.promise.startswith("one") else "yes" if row.kept(found) else "refused" if found.refused else "no"
    return [
        row.machine,
        row.detector,
        f"{row.promised:g}",
        row.promise,
        seed,
        *numbers,
        found.method,
        found.runs,
        f"{found.effective:.0f}",
        kept,
    ]


def _summary(rows: Sequence[Row]) -> str:
    promised = [row for row in rows if row.promise == "the promise"]
    refused = [row for row in promised if row.found.refused]
    outside = [row for row in promised if not row.found.refused and not row.kept(row.found)]
    text = [
        "## What came out",
        "",
        f"{len(promised)} combinations of machine, detector and rate promise a rate. At 99 % about {0.01 * len(promised):.1f} of their "
        f"intervals miss the truth by chance. {len(outside)} did not hold the promise in the first run (seed 1); each was repeated "
        f"once with the seed declared for it (2). {len(refused)} were refused for want of effective alarms.",
        "",
    ]
    if outside:
        text += ["| machine | detector | promised | first | repeated | inside |", "|---|---|---|---|---|---|"]
        for row in outside:
            again = row.again
            verdict = "" if again is None else "yes" if row.kept(again) else "**no**"
            text.append(
                f"| {MACHINES[row.machine][0]} | `{row.detector}` | {row.promised:g} | {row.found} | {again or ''} | {verdict} |"
            )
        text.append("")
    still = [row for row in outside if row.again is not None and not row.kept(row.again)]
    bank = [row for row in rows if row.promise == "at most the promise"]
    below = sum(row.kept(row.found) for row in bank)
    text += [
        f"Outside both times: {len(still)}. Upper bounds: the whole interval is below the promise in {below} of {len(bank)}.",
        "",
    ]
    return "\n".join(text) + "\n"


def _tables(rows: Sequence[Row]) -> str:
    text = [
        "## Every combination",
        "",
        "Rate found (99 % interval) in units of the promised rate; * counted, otherwise weighted.",
        "",
    ]
    for key in dict.fromkeys(row.machine for row in rows):
        text += [
            f"### {MACHINES[key][0]}",
            "",
            "| detector | " + " | ".join(f"{r:g}" for r in RATES) + " |",
            "|---" * (1 + len(RATES)) + "|",
        ]
        mine = [row for row in rows if row.machine == key]
        for name in dict.fromkeys(row.detector for row in mine):
            cells = [_relative(row) for rate in RATES for row in mine if row.detector == name and row.promised == rate]
            text.append(f"| `{name}` | " + " | ".join(cells) + " |")
        text.append("")
    return "\n".join(text) + "\n"


def _relative(row: Row) -> str:
    r, f = row.promised, row.found
    if row.promise == "at most the promise":
        return f"at most {f.high / r:.2g}" + ("" if f.weighted else "*")
    if f.refused:
        return f"refused ({f.effective:.0f} effective)"
    mark = "" if f.weighted else "*"
    return f"{f.value / r:.3g} ({f.low / r:.3g} to {f.high / r:.3g}){mark}"


def agreement(agreed: dict[str, list[tuple[str, float, Agreement]]]) -> str:
    text = [
        "", AGREEMENT, "",
        "Bursts of one long record of a healthy machine, alarms of the detector and of the short route, decisions that differ. Bursts",
        "the gate refused to judge (on the bearing the first of every record: too few quiet samples came before it) are left out of both.",
        "For `passive_cusum` records of ten stretches, and the first alarm must fall on the same sample.", "",
        "| machine | detector | bursts | alarms at 0.1 (short route) | alarms at 0.01 (short route) | refused | decisions that differ |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    total = differ = 0
    for key, found in agreed.items():
        for name in dict.fromkeys(n for n, _, _ in found):
            often, seldom = (next(a for n, r, a in found if n == name and r == rate) for rate in (0.1, 0.01))
            both = (often, seldom)
            total, differ = total + sum(a.bursts for a in both), differ + sum(a.differ for a in both)
            text.append(
                f"| {MACHINES[key][0]} | `{name}` | {often.bursts} + {seldom.bursts} | {often.alarms} ({often.short}) | "
                f"{seldom.alarms} ({seldom.short}) | {sum(a.refused for a in both)} | {sum(a.differ for a in both)} |"
            )
    text += ["", f"{differ} of {total} decisions differ."]
    return "\n".join(text) + "\n"
