"""Results of a study as tables: headings and rows, from which markdown and HTML are made alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from afdsvc.trial.plan import FIELD
from afdsvc.trial.scoring.field_tables import field_tables
from afdsvc.trial.scoring.rates import ReportTable, Result, share
from afdsvc.trial.scoring.rival import UNDECIDABLE

NOTE = (
    "One effect hidden, multisines at two levels. Intervals: 95 %, Wilson. Not decidable: the first name, fitted as well as it "
    f"can be, differs from what is hidden by less than d = {UNDECIDABLE} (the best possible test errs more than once in a hundred)."
)
PLAIN = ("bearing", "axis")  # parts that ask for one effect under good conditions


def tables(results: Sequence[Result]) -> list[ReportTable]:
    """Return everything a report shows, most important first."""
    field, others = [r for r in results if r["part"] == FIELD], _others(results)
    made = [_severity, _parts, _held, _kinds, _confusion, _failures] if others else []
    return [make(others) for make in made] + (field_tables(field) if field else [])


def _others(results: Sequence[Result]) -> list[Result]:
    return [r for r in results if r["part"] != FIELD]


def _scores(results: Iterable[Result], parts: tuple[str, ...] | None = None) -> list[Mapping[str, Any]]:
    return [r["score"] for r in results if parts is None or r["part"] in parts]


def _count(scores: Iterable[Mapping[str, Any]], key: str) -> str:
    """Return how often a score is true among those where it was asked."""
    asked = [s[key] for s in scores if s[key] is not None]
    return share(sum(asked), len(asked))


def _severity(results: Sequence[Result]) -> ReportTable:
    rows = []
    plain = [r for r in results if r["part"] in PLAIN and r["score"]["question"] == "physics"]
    scores = _scores(plain)
    for rho in sorted({s["rho"] for s in scores}, reverse=True):
        here = [s for s in scores if s["rho"] == rho]
        decided = _decidable([r for r in plain if r["score"]["rho"] == rho])
        columns = [_count(here, k) for k in ("first", "in_set", "place", "verdict_ok", "confident_false")]
        rows.append((f"{rho:g}", columns[0], decided, *columns[1:]))
    head = (
        "rho", "right name and site first", "or not decidable and among the look-alikes", "among the look-alikes", "right site",
        "right verdict", "confident false name",
    )
    return ReportTable("By severity", NOTE, head, tuple(rows))


def _decidable(results: Sequence[Result]) -> str:
    """Return how often the first name was right, or the right one among the look-alikes where no test could tell them apart."""
    close = [r.get("apart") is not None and r["apart"] < UNDECIDABLE and r["score"]["in_set"] for r in results]
    good = [bool(r["score"]["first"]) or c for r, c in zip(results, close, strict=True)]
    return share(sum(good), len(good))


def _parts(results: Sequence[Result]) -> ReportTable:
    head = (
        "part", "right verdict", "right first", "among the named", "both named", "located", "false name", "confident false name",
        "a further effect that is not there", "median time [s]",
    )
    keys = ("verdict_ok", "first", "in_set", "both", "located", "false_name", "confident_false", "extra_false")
    rows = []
    for part in dict.fromkeys(r["part"] for r in results):
        here = [r for r in results if r["part"] == part]
        seconds = float(np.median([r["seconds"] for r in here]))
        rows.append((part, *(_count(_scores(here), key) for key in keys), f"{seconds:.1f}"))
    return ReportTable("By part of the study", "A dash: not asked in this part.", head, tuple(rows))


def _held(results: Sequence[Result]) -> ReportTable:
    rows = []
    shares = [s for s in _scores(results) if s["held_share"] is not None]
    for rho in sorted({s["rho"] for s in shares}, reverse=True):
        values = np.array([s["held_share"] for s in shares if s["rho"] == rho])
        reached = share(int((values >= 0.98).sum()), values.size)
        rows.append((f"{rho:g}", f"{np.median(values):.3f}", f"{np.quantile(values, 0.1):.3f}", reached))
    head = ("rho", "median", "tenth percentile", "0.98 or more")
    note = "Error on the holdout against the oracle (the true structure refitted), where the first name is right."
    return ReportTable("Share of the oracle's improvement", note, head, tuple(rows))


def _kinds(results: Sequence[Result]) -> ReportTable:
    scores = [s for s in _scores(results) if s["first"] is not None and s["question"] in ("physics", "change")]
    rhos = sorted({s["rho"] for s in scores}, reverse=True)
    rows = []
    for truth in sorted({s["truth"] for s in scores}):
        cells = [_few([s for s in scores if s["truth"] == truth and s["rho"] == rho]) for rho in rhos]
        rows.append((truth, *cells))
    note = "Right first / among the look-alikes / trials, all parts."
    return ReportTable("By kind", note, ("hidden", *(f"rho {rho:g}" for rho in rhos)), tuple(rows))


def _few(scores: list[Mapping[str, Any]]) -> str:
    return f"{sum(s['first'] for s in scores)} / {sum(s['in_set'] for s in scores)} / {len(scores)}" if scores else ""


def _confusion(results: Sequence[Result]) -> ReportTable:
    pairs = Counter((s["truth"], s["said"]) for s in _scores(results))
    rows = []
    for truth in sorted({truth for truth, _ in pairs}):
        said = sorted(((n, name) for (t, name), n in pairs.items() if t == truth), key=lambda x: (-x[0], x[1]))
        rows.append((truth, str(sum(n for n, _ in said)), ", ".join(f"{name} {n}" for n, name in said)))
    note = "First name, or the verdict where nothing is named, with counts."
    return ReportTable("What was said", note, ("hidden", "trials", "said"), tuple(rows))


def _failures(results: Sequence[Result]) -> ReportTable:
    rows = []
    for r in results:
        s = r["score"]
        wrong = s["false_name"] or s["extra_false"] or not s["verdict_ok"] or s["first"] is False
        if wrong:
            d = "" if r.get("apart") is None else f"{r['apart']:.1f}"
            what = (_hidden(r), f"{s['rho']:g}", s["verdict"], _named(r))
            rows.append((str(r["number"]), r["part"], *what, d, r["answer"]["seed"]))
    head = ("trial", "part", "hidden", "rho", "verdict", "named", "d", "seed")
    return ReportTable("Every failure", "Wrong verdict, wrong first name, a false name, or a further effect that is not there.", head, tuple(rows))


def _hidden(result: Result) -> str:
    return ", ".join(f"{h['physics']} {h['parameter']} @ {h['site']}" for h in result["answer"]["hidden"]) or "nothing"


def _named(result: Result) -> str:
    named = result["explanation"].get("named", [])
    return ", ".join(f"{e.get('physics')} @ {e.get('site')} {e.get('weight', 1):.2f}" for e in named[:4])


def confusion_matrix(results: Sequence[Result]) -> tuple[list[str], list[str], np.ndarray]:
    """Return labels hidden, labels said, and counts, shape ``(hidden, said)``; single effects and nothing."""
    scores = [s for s in _scores(_others(results)) if s["question"] != "two"]
    hidden = sorted({s["truth"] for s in scores})
    said = sorted({s["said"] for s in scores}, key=lambda name: (name not in hidden, name))
    counts = np.zeros((len(hidden), len(said)), dtype=int)
    for s in scores:
        counts[hidden.index(s["truth"]), said.index(s["said"])] += 1
    return hidden, said, counts
