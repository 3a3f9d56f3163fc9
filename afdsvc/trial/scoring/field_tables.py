"""Results of field trials as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from afdsvc.trial.scoring.rates import ReportTable, Result, share

OUTCOMES = ("first", "among", "partial", "unexplained", "silent", "false", "error")
EDGES = (0.2, 0.45, 0.65, 0.9)  # of the shares asked for
NOTE = (
    "Recordings like those of real machines; share: of the nominal model's held-out error. First: the first name is right; among: a right one "
    "is named; partial: a defensible one is; unexplained: a gap is reported and nothing claimed; silent: no gap is reported, or only what the conditions bring along; false: all that "
    "is named is false."
)


def field_tables(results: Sequence[Result]) -> list[ReportTable]:
    """Return the tables of the field trials, most important first."""
    hidden = [r for r in results if r["score"]["question"] != "nothing"]
    return [
        _questions(results),
        _outcomes("By size of the effect", "share", hidden, lambda r: _bin(float(r["score"]["rho"]))),
        _outcomes("By family", "family", hidden, lambda r: str(r["score"]["family"])),
        _outcomes("By excitation", "excitation", hidden, lambda r: str(r["answer"]["conditions"]["excitation"])),
        _held(hidden),
        _failures(results),
    ]


def _questions(results: Sequence[Result]) -> ReportTable:
    rows = []
    for question in ("one", "several", "outside", "nothing"):
        scores = [r["score"] for r in results if r["score"]["question"] == question]
        if scores:
            counts = [share(sum(bool(s[key]) for s in scores), len(scores)) for key in ("right", "false_name", "confident_false")]
            said = Counter(s["outcome"] for s in scores).most_common()
            rows.append((question, *counts, str(sum(s["consistent_wrongly"] for s in scores)), ", ".join(f"{o} {n}" for o, n in said)))
    head = ("hidden", "good answer", "a false name", "a confident false name", "wrongly consistent", "outcomes")
    note = NOTE + " Good: first; with laws outside of the vocabulary also among, partial and unexplained; with nothing hidden no name."
    return ReportTable("Field trials", note, head, tuple(rows))


def _outcomes(title: str, what: str, results: Sequence[Result], key: Callable[[Result], str]) -> ReportTable:
    rows = []
    for name in sorted({key(r) for r in results}):
        scores = [r["score"] for r in results if key(r) == name]
        counts = Counter(s["outcome"] for s in scores)
        good = share(sum(s["right"] for s in scores), len(scores))
        rows.append((name, good, *(str(counts[o] or "") for o in OUTCOMES), str(sum(s["confident_false"] for s in scores) or "")))
    return ReportTable(title, "Trials in which something is hidden.", (what, "good answer", *OUTCOMES, "confident false name"), tuple(rows))


def _bin(rho: float) -> str:
    for low, high in pairwise(EDGES):
        if rho <= high:
            return f"{low:g} to {high:g}"
    return f"above {EDGES[-1]:g}"


def _held(results: Sequence[Result]) -> ReportTable:
    rows = []
    for found in OUTCOMES[:3]:
        values = [r["score"]["held_share"] for r in results if r["score"]["outcome"] == found and r["score"]["held_share"] is not None]
        if values:
            rows.append((found, str(len(values)), f"{np.median(values):.2f}", f"{np.quantile(values, 0.1):.2f}"))
    note = "Improvement on the holdout over that of an oracle, who knows the hidden laws and refits them."
    return ReportTable("Share of the oracle's improvement, field trials", note, ("outcome", "trials", "median", "tenth percentile"), tuple(rows))


def _failures(results: Sequence[Result]) -> ReportTable:
    rows = []
    for r in results:
        s = r["score"]
        if not s["right"] or s["false_name"]:
            named = ", ".join(f"{e.get('physics')} {e.get('weight', 1):.2f}" for e in r["explanation"].get("named", [])[:4])
            what = (s["family"], s["truth"], f"{r['answer']['share']:.2f}", s["outcome"], s["verdict"], named)
            rows.append((str(r["number"]), *what, r["answer"]["seed"]))
    head = ("trial", "family", "hidden", "share", "outcome", "verdict", "named", "seed")
    return ReportTable("Field trials without a good answer, or with a false name", "", head, tuple(rows))
