"""The report of a study as markdown and as one HTML page without anything to load."""

from __future__ import annotations

import html
from collections.abc import Sequence

from afdsvc.trial.plan import FIELD
from afdsvc.trial.scoring.rates import ReportTable, Result
from afdsvc.trial.scoring.tables import confusion_matrix, tables

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
