"""Tables and pages: one HTML page with everything, one Markdown page for the documentation."""

from __future__ import annotations

import datetime
import html
import platform
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from delay import Delays
from isolation import KNOWN, Isolation
from power import AVERAGE, BOUND, PROMISED, Powers

OURS = ("regression", "iterated_regression", "fault_curves", "matched_filter", "cusum", "cusum, deflection 5")


@dataclass
class Results:
    """All that was found, and how."""

    command: str
    rate: float
    powers: list[Powers] = field(default_factory=list)
    delays: list[Delays] = field(default_factory=list)
    isolations: list[Isolation] = field(default_factory=list)
    pictures: dict[str, str] = field(default_factory=dict)
    cpu_seconds: float = 0.0


@dataclass(frozen=True)
class Table:
    """A heading, a sentence, columns and rows."""

    title: str
    text: str
    header: list[str]
    rows: list[list[str]]
    picture: str = ""


def tables(found: Results) -> list[Table]:
    """Return everything in the order it is read."""
    out = [_summary(found), _held(found)]
    for powers in found.powers:
        out += [_power(powers, found.rate)]
    out += [_delay(d) for d in found.delays] + [_same(d) for d in found.delays] + [_active(d) for d in found.delays]
    out += [_isolation(i) for i in found.isolations] + [_two_steps(i) for i in found.isolations if i.two_step]
    return [*out, _effort(found)]


def _summary(found: Results) -> Table:
    """Return the powers at the severity that clairvoyance finds most of the time, machine beside machine."""
    names = list(dict.fromkeys(n for p in found.powers for n in (BOUND, AVERAGE, *p.power)))
    at = [p.case.severities.index(p.roc_severity) for p in found.powers]
    rows = []
    for name in names:
        cells = [p.power[name][k] if name in p.power else None for p, k in zip(found.powers, at, strict=True)]
        rows.append([name, *("" if s is None else f"{s.value:.2f} ({s.low:.2f} to {s.high:.2f})" for s in cells)])
    header = ["detector", *(f"{p.case.title}, {-100 * p.roc_severity:g} % lost" for p in found.powers)]
    text = f"Detection probability at {found.rate:g} false alarms per burst, at the loss of those looked at that clairvoyance finds about 85 times in 100."
    return Table("In one table", text, header, rows)


def _held(found: Results) -> Table:
    rows = []
    for powers in found.powers:
        for name, rates in powers.held.items():
            rows.append([powers.case.title, name, *(f"{rates[r]}" if r in rates else "" for r in PROMISED)])
    header = ["machine", "detector", *(f"held where {r:g} is promised" for r in PROMISED)]
    text = (
        "Share of healthy bursts that alarm at the detector's own threshold, with 95 % intervals. `model_bank` promises an upper "
        "bound, the published filters the rate of a single template; the shelf detectors promise nothing in these units."
    )
    return Table("Promised and held alarm rates", text, header, rows)


def _power(powers: Powers, rate: float) -> Table:
    names = [n for n in (BOUND, AVERAGE, *powers.power) if n in powers.power]
    names = list(dict.fromkeys(names))
    rows = [[n, *(str(s) for s in powers.power[n])] for n in names]
    header = ["detector", *(f"{-100 * s:g} % lost" for s in powers.case.severities)]
    text = (
        f"Detection probability at {rate:g} false alarms per burst, all thresholds calibrated on the same healthy bursts, faults "
        f"taking turns. {powers.bursts:,} bursts of {powers.case.burst.samples} samples, output amplitude of a line "
        f"{powers.case.burst.notes['output_amplitude']} {powers.case.amplitude_unit}."
    )
    return Table(powers.case.title, text, header, rows, f"power-{powers.case.key}")


def _delay(found: Delays) -> Table:
    rows = [
        [word, f"{-100 * s:g} %", str(measured), f"{exact:.3g}", f"{first:.3g}"]
        for word, by in found.passive.items() for s, (measured, exact, first) in by.items()
    ]  # fmt: skip
    header = ["false alarms", "lost", "passive_cusum [s]", "CUSUM that knows, theory [s]", "ln(run length) / I [s]"]
    text = f"{found.fault}, fault switched on at the worst moment, detector tuned to the severity, four faults watched, own thresholds."
    return Table(f"Delay without excitation: {found.case.title}", text, header, rows, f"delay-{found.case.key}")


def _same(found: Delays) -> Table:
    rows = [[name, str(delay), str(run)] for name, (delay, run) in found.same.items()]
    header = ["detector", "mean delay [s]", "seconds between false alarms, calibrated"]
    text = (
        f"{found.fault}, {-100 * found.same_severity:g} % lost, no excitation. CUSUM that knows fault and severity, in theory: "
        f"{found.same_bound:.3g} s. Delays are cut at 0.8 s, which flatters the slow."
    )
    return Table(f"Delay at the same run length: {found.case.title}", text, header, rows)


def _active(found: Delays) -> Table:
    rows = [[f"{-100 * s:g} %", str(m), f"{share:.2f}", f"{best:.3g}"] for s, (m, share, best) in found.active.items()]
    header = ["lost", "mean time to alarm [s]", "bursts that alarm", "minimax for the known wave [s]"]
    text = f"{found.fault}, `cusum` as designed by default; a test over the whole burst needs {found.case.burst.samples * found.case.problem.plant.dt:g} s."
    return Table(f"Delay inside a burst: {found.case.title}", text, header, rows)


def _isolation(found: Isolation) -> Table:
    rows = []
    for name, shares in found.top.items():
        rows.append([name, "right on top", *(str(s) for s in shares)])
        if name != KNOWN:
            rows.append([name, "right one named", *(str(s) for s in found.named[name])])
            rows.append([name, "wrong one named", *(str(s) for s in found.wrong[name])])
    header = ["detector", "", *(f"{a:.3g} {found.case.amplitude_unit}" for a in found.output)]
    text = f"{-100 * found.case.isolation_severity:g} % lost; named: weight above 0.99."
    return Table(f"Isolation against output amplitude: {found.case.title}", text, header, rows)


def _two_steps(found: Isolation) -> Table:
    rows = [[step, *(str(s) for s in shares)] for step, shares in found.two_step.items()]
    text = (
        f"A first burst of {found.output[1]:.3g} {found.case.amplitude_unit}; where it leaves two suspects, a second one designed for "
        f"that pair (at most {found.second_output:.3g} {found.case.amplitude_unit} of output); `fault_curves` decides."
    )
    return Table(f"Two-step isolation: {found.case.title}", text, ["", "right named", "wrong named", "left open"], rows)


def _effort(found: Results) -> Table:
    names = list(dict.fromkeys(n for p in found.powers for n in p.cpu))
    rows = [[n, *(f"{p.cpu.get(n, 0.0):.1f}" for p in found.powers)] for n in names]
    worst = max([0.0, *(v for p in found.powers for v in p.short_cuts.values()), *(i.short_cuts for i in found.isolations)])
    text = (
        f"Whole run: {found.cpu_seconds:.0f} CPU seconds on one core. CPU seconds for the scores below (slow detectors see every "
        f"fourth to twelfth burst). Short cuts against the detectors themselves: largest difference {worst:.1g}."
    )
    return Table("Cost of the comparison", text, ["detector", *(p.case.title for p in found.powers)], rows)


def versions() -> str:
    """Return the versions of what was compared."""
    found = []
    for name in ("ruptures", "river", "numpy", "scipy"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} not installed (left out)")
    return ", ".join(found)


def stamp(found: Results) -> str:
    """Return when, with what and how this was written."""
    return (
        f"Written {datetime.date.today().isoformat()} by `{found.command}` (Python {platform.python_version()}, {versions()}, "
        f"{found.cpu_seconds:.0f} CPU seconds)."
    )


CSS = """body{font:15px/1.45 system-ui,sans-serif;max-width:1180px;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;font-size:12px;margin:.6rem 0 1.6rem}th,td{border:1px solid #ccc;padding:.2rem .45rem;text-align:left}
th{background:#f2f2f2}img{max-width:100%}code{background:#f4f4f4;padding:0 .2rem}.wide{overflow-x:auto}"""


def html_page(found: Results, intro: str, folder: Path) -> Path:
    """Write the page; pictures lie beside it."""
    parts = [f"<h1>Fault detectors compared</h1><p>{_code(html.escape(stamp(found)))}</p>", *(f"<p>{_code(html.escape(p))}</p>" for p in intro.split("\n\n"))]
    for table in tables(found):
        parts += [f"<h2>{html.escape(table.title)}</h2><p>{_code(html.escape(table.text))}</p>"]
        parts += [f'<img alt="{html.escape(table.title)}" src="{found.pictures[n]}">' for n in _pictures(table, found)]
        parts.append(_html_table(table))
    parts += [f'<h2>Isolation, all machines</h2><img alt="isolation" src="{found.pictures["isolation"]}">'] if "isolation" in found.pictures else []
    path = folder / "index.html"
    head = f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Fault detectors compared</title><style>{CSS}</style></head>'
    path.write_text(f"{head}<body>{''.join(parts)}</body></html>\n")
    return path


def _pictures(table: Table, found: Results) -> list[str]:
    """Return the names of the pictures that belong to a table."""
    wanted = dict.fromkeys([table.picture, table.picture.replace("power-", "faults-")])
    return [name for name in wanted if name in found.pictures]


def _code(text: str) -> str:
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", text)


def _html_table(table: Table) -> str:
    def row(cells: list[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) + "</tr>"

    return '<div class="wide"><table>' + row(table.header, "th") + "".join(row(r, "td") for r in table.rows) + "</table></div>"


def markdown(found: Results, intro: str, link: Callable[[str], str]) -> str:
    """Return the page for the documentation; ``link`` gives the path of a picture."""
    parts = ["# Fault detectors compared", stamp(found), intro]
    for table in tables(found):
        parts.append(f"## {table.title}\n\n{table.text}")
        parts += [f"![{table.title}]({link(found.pictures[n])})" for n in _pictures(table, found)]
        parts.append(_markdown_table(table))
    if "isolation" in found.pictures:
        parts.append(f"## Isolation, all machines\n\n![isolation against output amplitude]({link(found.pictures['isolation'])})")
    return "\n\n".join(parts) + "\n"


def _markdown_table(table: Table) -> str:
    lines = ["| " + " | ".join(table.header) + " |", "|" + "---|" * len(table.header)]
    return "\n".join(lines + ["| " + " | ".join(r) + " |" for r in table.rows])
