"""`afdsvc explain` on recordings of real machines: names, weights and held-out errors as a table.

    python benchmarks/explain/real_machines.py FOLDER [--exchanged | --cut | --half] [CASE ...]

``FOLDER`` holds one folder per case: ``model.toml``, ``train*.csv``, ``holdout*.csv`` and, for the judgement, ``truth.json`` with
``accept`` (names that are right) and ``partial`` (defensible ones). The recordings are not part of this repository. The options divide
them otherwise: fitted and held-out recordings exchanged; every fitted one cut in two, each with a new time; half of the fitted ones (the
second half of a single one).
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.errors import BadInput

CONFIDENT = 0.9  # weight from which a wrong name counts as a confident one


def cut(table: Path, out: Path) -> list[Path]:
    """Return the two halves of a table, each with a time that begins at zero."""
    head, *rows = table.read_text(encoding="utf-8").splitlines()
    time_column, found = head.split(",").index("t"), []
    for k, part in enumerate((rows[: len(rows) // 2], rows[len(rows) // 2 :])):
        cells = [r.split(",") for r in part]
        start = float(cells[0][time_column])
        for c in cells:
            c[time_column] = f"{float(c[time_column]) - start:.9g}"
        found.append(out / f"{table.stem}{'ab'[k]}.csv")
        found[-1].write_text("\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8")
    return found


def divided(folder: Path, how: str, out: Path) -> tuple[list[Path], list[Path]]:
    """Return the recordings to fit and those held out."""
    fitted, held = (sorted(folder.glob(f"{kind}*.csv")) for kind in ("train", "holdout"))
    if how == "--exchanged":
        return held, fitted
    if how == "--cut":
        return [half for table in fitted for half in cut(table, out)], held
    if how == "--half":
        return fitted[: (len(fitted) + 1) // 2] if len(fitted) > 1 else cut(fitted[0], out)[1:], held
    return fitted, held


def explained(folder: Path, how: str, out: Path) -> dict[str, Any]:
    """Return the document of one case, or its refusal as a sentence."""
    begin = time.perf_counter()
    out.mkdir(exist_ok=True)
    try:
        document = explain_files(folder / "model.toml", *divided(folder, how, out), ExplainOptions(out=out, allow_code=True))
    except BadInput as error:
        document = {"verdict": f"refused: {error}", "named": [], "fit": {"per_output": {}}}
    return {**document, "seconds": time.perf_counter() - begin}


def judged(document: dict[str, Any], truth: dict[str, Any]) -> str:
    """Return "right", "partial", "silent" or "wrong", with "confident" before the latter where the weight says so."""
    names, accept, partial = document["named"], truth.get("accept", []), truth.get("partial", [])
    if not names:
        return "right" if document["verdict"] in accept else "silent"
    first = names[0]
    if first["physics"] in accept:
        return "right"
    if first["physics"] in partial or any(n["physics"] in accept for n in names):
        return "partial"
    return "confident wrong" if first["weight"] >= CONFIDENT else "wrong"


def row(name: str, document: dict[str, Any], truth: dict[str, Any]) -> str:
    """Return the table's row of one case."""
    fits = list(document["fit"]["per_output"].values())
    before, after = (np.mean([f[k]["nrmse"] or np.inf for f in fits]) if fits else np.nan for k in ("before", "after"))
    named = ", ".join(f"{n['physics']} at {n['site']} ({n['weight']:.2f})" for n in document["named"][:3]) or "none"
    verdict = f"{document['verdict']} | {named} | {100 * before:.1f} | {100 * after:.1f} | {judged(document, truth)} | {document['seconds']:.0f}"
    return f"| {name} | {verdict} |"


def main(folder: Path, how: str, cases: list[str]) -> None:
    """Print the table of all cases, or of those named, and keep the documents beside the reports."""
    out = Path(f"real-machines{how}")
    out.mkdir(exist_ok=True)
    print("| case | verdict | names (weight) | held-out error before [%] | after [%] | first name | seconds |\n|---|---|---|---|---|---|---|", flush=True)
    for case in sorted(p.parent for p in folder.glob("*/model.toml")):
        if cases and case.name not in cases:
            continue
        document = explained(case, how, out / case.name)
        (out / f"{case.name}.json").write_text(json.dumps(document), encoding="utf-8")
        truth = case / "truth.json"
        print(row(case.name, document, json.loads(truth.read_text(encoding="utf-8")) if truth.exists() else {}), flush=True)


if __name__ == "__main__":
    how = "".join(a for a in sys.argv[2:] if a.startswith("--"))
    main(Path(sys.argv[1]), how, [a for a in sys.argv[2:] if a != how])
