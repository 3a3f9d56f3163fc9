"""Results of a study as tables, in markdown and as one HTML page."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from afdsvc.trial.matching import UNDECIDABLE
from afdsvc.trial.study import FIELD

Result = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table with a title, a sentence that says what is in it, headings and rows of text."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def share(hits: int, count: int) -> str:
    """Return hits of count with the 95 % interval of Wilson, as text."""
    if not count:
        return "-"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({100 * hits / count:.0f} %, {100 * low:.0f} to {100 * high:.0f})"


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return the interval of Wilson for a share (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    p, n = hits / count, count
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


OUTCOMES = ("first", "among", "partial", "unexplained", "silent", "false", "error")
EDGES = (0.2, 0.45, 0.65, 0.9)  # of the shares asked for
FIELD_NOTE = (
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
        _field_held(hidden),
        _field_failures(results),
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
    note = FIELD_NOTE + " Good: first; with laws outside of the vocabulary also among, partial and unexplained; with nothing hidden no name."
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


def _field_held(results: Sequence[Result]) -> ReportTable:
    rows = []
    for found in OUTCOMES[:3]:
        values = [r["score"]["held_share"] for r in results if r["score"]["outcome"] == found and r["score"]["held_share"] is not None]
        if values:
            rows.append((found, str(len(values)), f"{np.median(values):.2f}", f"{np.quantile(values, 0.1):.2f}"))
    note = "Improvement on the holdout over that of an oracle, who knows the hidden laws and refits them."
    return ReportTable("Share of the oracle's improvement, field trials", note, ("outcome", "trials", "median", "tenth percentile"), tuple(rows))


def _field_failures(results: Sequence[Result]) -> ReportTable:
    rows = []
    for r in results:
        s = r["score"]
        if not s["right"] or s["false_name"]:
            named = ", ".join(f"{e.get('physics')} {e.get('weight', 1):.2f}" for e in r["explanation"].get("named", [])[:4])
            what = (s["family"], s["truth"], f"{r['answer']['share']:.2f}", s["outcome"], s["verdict"], named)
            rows.append((str(r["number"]), *what, r["answer"]["seed"]))
    head = ("trial", "family", "hidden", "share", "outcome", "verdict", "named", "seed")
    return ReportTable("Field trials without a good answer, or with a false name", "", head, tuple(rows))


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


STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:1rem 0}td,th{border:1px solid #ddd;padding:.2rem .5rem;text-align:left;font-size:13px}
th{background:#f4f4f4}.matrix th.turn{writing-mode:vertical-rl;transform:rotate(180deg)}.matrix td{text-align:center;min-width:1.4rem}
@media (prefers-color-scheme:dark){body{background:#181818;color:#ddd}th{background:#2a2a2a}td,th{border-color:#444}}"""


def markdown(results: Sequence[Result], title: str = "Blind trials") -> str:
    """Return the report as markdown."""
    return f"# {title}\n\n{summary(results)}\n" + "".join(_markdown_table(t) for t in tables(results))


def page(results: Sequence[Result], title: str = "Blind trials") -> str:
    """Return the report as HTML, with the confusion matrix."""
    parts = [_html_table(t) for t in tables(results)]
    if any(r["part"] != FIELD for r in results):
        parts.insert(4, _matrix(results))
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title><style>{STYLE}</style>"
    return f"{head}<h1>{html.escape(title)}</h1><p>{html.escape(summary(results))}</p>{''.join(parts)}</html>\n"


def summary(results: Sequence[Result]) -> str:
    """Return what came of the study in one sentence."""
    scores = [r["score"] for r in results]
    nothing = [s for s in scores if s["question"] == "nothing"]
    kinds = {h.get("physics") or h["law"] for r in results for h in r["answer"]["hidden"]}
    return (
        f"{len(results)} trials over {len(kinds)} kinds of effect; {len(nothing)} with nothing hidden, of which "
        f"{sum(s['false_name'] for s in nothing)} were given a name ({sum(s['confident_false'] for s in nothing)} with confidence); "
        f"{sum(s['confident_false'] for s in scores)} confident false names in all."
    )


def _markdown_table(table: ReportTable) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |\n"

    rule = "|" + "---|" * len(table.head) + "\n"
    return f"\n## {table.title}\n\n{table.note}\n\n{line(table.head)}{rule}{''.join(map(line, table.rows))}"


def _html_table(table: ReportTable) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(row(cells, "td") for cells in table.rows)
    return f"<h2>{html.escape(table.title)}</h2><p>{html.escape(table.note)}</p><table>{row(table.head, 'th')}{body}</table>"


def _matrix(results: Sequence[Result]) -> str:
    hidden, said, counts = confusion_matrix(results)
    top = "".join(f"<th class=turn>{html.escape(name)}</th>" for name in said)
    rows = []
    for name, line in zip(hidden, counts, strict=True):
        largest = max(int(line.sum()), 1)
        cells = "".join(_cell(int(n), int(n) / largest, name == other) for n, other in zip(line, said, strict=True))
        rows.append(f"<tr><th>{html.escape(name)}</th>{cells}</tr>")
    return f"<h2>Confusion matrix</h2><p>Rows: hidden; columns: said.</p><table class=matrix><tr><th></th>{top}</tr>{''.join(rows)}</table>"


def _cell(count: int, weight: float, right: bool) -> str:
    if not count:
        return "<td></td>"
    colour = "40,140,60" if right else "190,60,40"
    return f'<td style="background:rgba({colour},{0.2 + 0.6 * weight:.2f})">{count}</td>'
