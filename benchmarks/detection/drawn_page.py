"""The page of models only roughly right, and its table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rates_baselines import BASELINES
from rates_cases import RATES
from rates_counting import Rate

if TYPE_CHECKING:
    from drawn import Row
    from drawn_cases import Doubtful
    from drawn_loss import Loss

INTRO = """\
# Models only roughly right: alarm rates and what they cost

Made by `python benchmarks/detection/drawn.py --docs` ({seconds:.0f} CPU seconds); every number is in
[detection-drawn.csv](detection-drawn.csv). The machine that makes the data is healthy, its uncertain parameters are drawn from
their stated distribution, a new machine for every burst; what is believed is the nominal model. Expected: alarms not above the promise.

Rates of 1/10 and 1/100 are counted on played bursts. Rarer ones are found by importance sampling, parameters drawn from a density part
of which is wider: for the line detectors and the CUSUM only the coordinates of the lines are drawn, with mean and covariance of each
machine; for the others whole bursts are played, with faults of two severities, and weighted by their likelihood without a fault over
that of the mixture. Those few hundred bursts are too few for the rare cells, which are refused. Intervals are 99 %. *Taken as certain*
is the same detector on the same machines with no uncertainty stated.

"""
BLIND = """\

`matched_filter`, `fault_curves`, `regression` and the CUSUMs take a stated uncertainty into account. `chi_square` and
`limit_check` (and `model_bank`, `iterated_regression`, the published filters) do not: they judge the model as it is, and alarm on one
that is wrong. The gate before every detector judges quiet data in the same way, parameters that explain them allowed.

"""


def write(cases: Sequence[Doubtful], rows: Sequence[Row], lost: Sequence[Loss], seconds: float, folder: Path) -> None:
    """Write page and table into a folder."""
    with (folder / "detection-drawn.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(
            ["machine", "detector", "promised", "model", "rate", "low", "high", "method", "runs", "effective", "not above"]
        )
        for row in rows:
            for model, found in (("doubtful", row.found), ("certain", row.certain)):
                numbers = [f"{x:.4g}" for x in (found.value, found.low, found.high)]
                above = "refused" if found.refused else "yes" if found.low <= row.promised else "no"
                tail = (found.method, found.runs, f"{found.effective:.0f}", above)
                out.writerow([row.case, row.detector, f"{row.promised:g}", model, *numbers, *tail])
    (folder / "detection-drawn.md").write_text(
        INTRO.format(seconds=seconds) + _rates(cases, rows) + BLIND + _losses(cases, lost)
    )


def _rates(cases: Sequence[Doubtful], rows: Sequence[Row]) -> str:
    aware = [row for row in rows if row.detector not in BASELINES]
    held, refused = sum(row.not_above for row in aware), sum(row.found.refused for row in aware)
    text = [
        f"Of {len(aware)} combinations of machine, rate and detector that reckons with the uncertainty, {held} are not above the promise, "
        f"{len(aware) - held - refused} are, {refused} were refused for want of effective alarms. Entries are in units of the promise.", "",
    ]  # fmt: skip
    for doubtful in cases:
        text += [
            f"## {doubtful.case.title}: {doubtful.about}",
            "",
            "| detector | " + " | ".join(f"{r:g}" for r in RATES) + " |",
        ]
        text.append("|---" * (1 + len(RATES)) + "|")
        mine = [row for row in rows if row.case == doubtful.case.key]
        for name in dict.fromkeys(row.detector for row in mine):
            own = [row for row in mine if row.detector == name]
            text.append(f"| `{name}` | " + " | ".join(_cell(row.found, row.promised) for row in own) + " |")
            if name not in BASELINES:
                text.append("| taken as certain | " + " | ".join(_cell(row.certain, row.promised) for row in own) + " |")
        text.append("")
    return "\n".join(text) + "\n"


def _cell(found: Rate, promised: float) -> str:
    if found.refused:
        return f"refused ({found.effective:.0f} effective)"
    text = f"{found.value / promised:.3g} ({max(found.low, 0) / promised:.3g} to {found.high / promised:.3g})"
    return f"**{text}**" if found.low > promised else text


def _losses(cases: Sequence[Doubtful], lost: Sequence[Loss]) -> str:
    text = [
        "## What is lost", "",
        "The severity a certain model would find with probability 0.9 at one false alarm in 100 bursts: deflections and the probability",
        "stated by the design, with the model certain and doubtful, and how often `fault_curves` finds it on machines drawn anew for every",
        "burst. The stated probability is that of a filter tuned to the fault.", "",
        "| machine | fault | severity | deflection, certain | doubtful | stated, certain | stated, doubtful | counted |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    titles = {doubtful.case.key: doubtful.case.title for doubtful in cases}
    for one in lost:
        text.append(
            f"| {titles[one.case]} | {one.fault} | {one.severity:.1%} | {one.deflections[0]:.2f} | {one.deflections[1]:.2f} | "
            f"{one.stated[0]:.3f} | {one.stated[1]:.3f} | {one.counted} |"
        )
    return "\n".join(text) + "\n"
