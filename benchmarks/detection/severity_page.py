"""The page of severities, and its table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm

if TYPE_CHECKING:
    from severity import Found

SURE = float(norm.isf(0.005))
BIAS, BOUND = 0.1, 0.1  # of a standard error; of the Cramer-Rao bound

INTRO = """\
# Severities: bias and standard error

Made by `python benchmarks/detection/severity.py --docs` ({seconds:.0f} CPU seconds): every setting is a machine with one fault, its
burst played {runs} times in closed loop; every number is in [detection-severity.csv](detection-severity.csv). Expected: a bias below a
tenth of the standard error, and a standard error within 10 % of the Cramer-Rao bound.

*Bias* is the mean error over the standard deviation of the estimates, *spread* that standard deviation over the bound, both with 99 %
intervals; *stated* is the mean standard error the detector itself reports, over the bound. `fault_curves` and `matched_filter` take
the severity from the same fit. Their bound is that of the excited lines, the samples between the ramps; the regressions' that of the
whole record, noise included (for `iterated_regression` without the samples in which its predictor settles), computed by differentiating
optimal predictors of the faulty machine, without any regressor of the detectors.

An estimate is unbiased where the residual has the properties the estimator assumes. Curves are exact for every fault, and so is the
iterated regression. One regression is exact for gain faults of stable plants with output noise; elsewhere it is a first-order
approximation, good for small faults and said not to be for large ones (*first order* in the table).

"""


def verdict(found: Found) -> str:
    """Return whether bias and standard error are as wanted."""
    if not found.meant:
        return "first order"
    bias, sd = abs(found.bias), abs(found.spread - 1)
    return "yes" if bias < BIAS and sd < BOUND and abs(found.reported - 1) < BOUND else "**no**"


def write(found: Sequence[Found], seconds: float, runs: int, folder: Path) -> None:
    """Write page and table into a folder."""
    with (folder / "detection-severity.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["setting", "estimator", "runs", "bias", "spread", "stated", "bound", "deviation", "mean", "held"])
        for one in found:
            numbers = (one.bias, one.spread, one.reported, one.bound, one.error.std(), one.setting.severity + one.error.mean())
            out.writerow([one.setting.title, one.estimator, runs, *(f"{x:.4g}" for x in numbers), verdict(one).strip("*")])
    held = sum(verdict(one) == "yes" for one in found)
    meant = sum(one.meant for one in found)
    wide = SURE / np.sqrt(runs)
    text = [
        f"{held} of {meant} estimates that are meant to be unbiased hold both. 99 % intervals are +-{wide:.3f} of the bias and "
        f"+-{100 * wide / np.sqrt(2):.1f} % of the spread.", "",
        "| setting | estimator | Cramer-Rao bound | bias [standard errors] | spread / bound | stated / bound | held |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for one in found:
        text.append(
            f"| {one.setting.title} | `{one.estimator.replace(', ', '`, `')}` | {one.bound:.4f} | {one.bias:+.3f} | {one.spread:.3f} | "
            f"{one.reported:.3f} | {verdict(one)} |"
        )
    (folder / "detection-severity.md").write_text(INTRO.format(seconds=seconds, runs=runs) + "\n".join(text) + "\n")
