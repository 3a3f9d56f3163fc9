"""Figures and tables of A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", DTU 2017, and its papers P1 to P6.

    python -m benchmarks.thesis list          every figure and table: what it shows, and its command or the reason why there is none
    python -m benchmarks.thesis p5-0.14       one of them: the printed numbers and statements beside ours
    python -m benchmarks.thesis pages         all of them, into docs/thesis/ (three minutes)
    python -m benchmarks.thesis record FOLDER [EXPERIMENT...]      the experiments behind them through rig agent, zenoh and service, into recordings (25 s each)
    python -m benchmarks.thesis p5-0.14 FOLDER/rest.mcap [SECONDS]   a figure from a recording of its experiment; SECONDS: when the fault began, where no event tells
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from afdsvc.errors import BadInput
from benchmarks.thesis import gas_bearing_figures, identification_figures, unavailable, unstable_plant_figures
from benchmarks.thesis.figure import Figure, Row
from benchmarks.thesis.recorded import EXPERIMENTS, Measured, record

PAGES = Path(__file__).resolve().parents[2] / "docs" / "thesis"
TITLES = {"chapter-1": "Chapter 1: introduction", "chapter-2": "Chapter 2: YJBK parameterisation", "chapter-3": "Chapter 3: the rig", "chapter-4": "Chapter 4: identification", "chapter-5": "Chapter 5: fault diagnosis",
          "p1": "P1: turboexpander", "p2": "P2: modified Hansen scheme", "p3": "P3: active fault detection", "p4": "P4: unstable plant and uncertainty", "p5": "P5: diagnosis of the gas bearing", "p6": "P6: identification of the gas bearing"}  # fmt: skip
MADE = "<!-- Written by python -m benchmarks.thesis pages; edit the code instead. -->\n\n"


def figures() -> list[Figure]:
    """Return every figure and table, page by page, in the order of the print."""
    found = [*gas_bearing_figures.FIGURES, *unstable_plant_figures.FIGURES, *identification_figures.FIGURES, *unavailable.FIGURES]
    return sorted(found, key=lambda f: (list(TITLES).index(f.page), f.name.startswith(("table", f"{f.page}-table")), [int(n) for n in re.findall(r"\d+", f.name)], f.name))


def shown(value: float | bool | None) -> str:
    """Return a number in four digits, a statement as yes or no."""
    return "" if value is None else ("yes" if value else "no") if isinstance(value, bool | np.bool_) else f"{value:.4g}"


def match(rows: Sequence[Row]) -> str:
    """Return how print and result agree."""
    wrong = sum(bool(r.erratum) and r.printed is not None for r in rows)
    compared = sum(r.printed is not None for r in rows)
    if not compared:
        return "no number in print"
    return f"{compared - wrong} of {compared}" + ("; the rest explained" if wrong else "")


def table(rows: Sequence[Row]) -> str:
    """Return the comparison as a Markdown table."""
    lines = [f"| {r.what} | {shown(r.printed)} | {shown(r.ours)} | {shown(r.tolerance) if r.tolerance else ''} | {r.erratum} |" for r in rows]
    return "| | print | ours | tolerance | remark |\n|---|---|---|---|---|\n" + "\n".join(lines) + "\n"


def write_pages() -> None:
    """Write a page for every chapter and paper, and the index."""
    PAGES.mkdir(exist_ok=True)
    index = ["| figure | shows | agrees | command, or why there is none |\n|---|---|---|---|\n"]
    for page, group in groupby(figures(), key=lambda f: f.page):
        parts = [MADE + f"# {TITLES[page]}\n"]
        for f in group:
            if f.remade is None:
                index.append(f"| {f.name} | {f.shows} | | {f.reason} |\n")
                continue
            rows = f.remade()
            print(f.name, match(rows), flush=True)
            index.append(f"| [{f.name}]({page}.md#{f.name.replace('.', '')}) | {f.shows} | {match(rows)} | `{f.command}`{' (long)' if f.long else ''} |\n")
            recorded = f"; from a recording: `{f.command} FOLDER/{f.experiment}.mcap`" if f.recorded else ""
            parts.append(f"\n## {f.name}\n\n{f.shows[0].upper() + f.shows[1:]}. `{f.command}`{recorded}\n\n{table(rows)}")
        if len(parts) > 1:
            (PAGES / f"{page}.md").write_text("".join(parts), encoding="utf-8")
    (PAGES / "README.md").write_text(MADE + INTRODUCTION + "".join(index), encoding="utf-8")


INTRODUCTION = """# The figures and tables of the thesis

A. K. Sekunda, *Fault Diagnosis and Identification of Electro-Mechanical Systems*, PhD thesis, Technical University of Denmark, 2017, with its
publications P1 to P6. Each figure and table that can be made without the authors' rig is remade by the command in its row, which prints
the numbers, and the statements that text and caption make about a plot, beside ours; `tests/thesis/` asserts every row. "Agrees" counts
the printed ones; where print and result differ the page says why ([errata](../explanation/errata.md)). Plots without printed numbers are compared
by what is said about them.

Every remade figure or table has at least one number compared; a statement in print that nothing in print quantifies ("similar", "almost the same") is
compared with a simulation, with what S predicts, or with zero error. The commands take seconds; those marked "long" some 15 s of a core.

The experiments behind the main figures of chapters 4 and 5, P3, P4 and P5 can also be run through the system, and these figures made from its
recordings: `python -m benchmarks.thesis record FOLDER` runs rig agent (the simulator) and service in two processes with zenoh between them, sines stated
in `bursts.lines`, 25 s each: `rest`, `turning`, `lqg`, `p3`, `p4-b1`, `p4-b2` with a fault in the middle, and `half-a`, whose model has half of the
machine's A. `python -m benchmarks.thesis p5-0.14 FOLDER/rest.mcap` makes a figure from what was recorded. A recording of a real rig that played the same
lines is read in the same way (with the second of the fault as a third argument). All rows of these seventeen figures hold for recordings too
(2026-11-25; `pytest -m long tests/thesis/test_recorded.py`). Not made from recordings: P1 (its sample time of 1 ms is chosen for identification, not for
a rig), P2 (a random plant), and the statistics over hundreds of models of figure 4.11 and P6.

"""


def main(arguments: Sequence[str]) -> int:
    """Print a figure, the list, or write the pages or recordings."""
    known, (name, *rest) = {f.name: f for f in figures()}, [*arguments, ""]
    figure, rest = known.get(name), [r for r in rest if r]
    if name == "list":
        for f in known.values():
            print(f"{f.name:14} {f.shows:75} {f.reason or f.command}{' (long)' if f.long else ''}{f' (or from a recording of {f.experiment})' if f.recorded else ''}")
    elif name == "pages":
        write_pages()
    elif name == "record" and rest:
        for experiment in rest[1:] or EXPERIMENTS:
            print(record(experiment, Path(rest[0])), flush=True)
    elif figure is None or (figure.remade is None) or (rest and figure.recorded is None):
        print(f"{name}: {figure.reason or 'is not made from a recording'}" if figure else __doc__)
        return 2
    else:
        rows = figure.recorded(Measured.of(Path(rest[0]), figure.experiment, *map(float, rest[1:]))) if rest and figure.recorded else figure.remade()
        print(f"{figure.name}: {figure.shows}\n\n{table(rows)}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except BadInput as error:
        sys.exit(str(error))
