"""A diagnosis as one self-contained HTML page: the answers first, then every decision they rest on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from afdsvc.errors import BadInput
from afdsvc.present.html import render, zoomable

COLOURS = ("#1b6ca8", "#c8553d", "#588157", "#7b4b94", "#c29200", "#3a3a3a")
NONE = "none_of_these"


def diagnose_page(document: Mapping[str, Any]) -> str:
    """Return the page for the document of ``diagnose --json``."""
    shown = [{**recording, "answer": verdict_words(recording["verdict"]), "severities": _severities(recording)} for recording in document["recordings"]]
    return render("diagnose_page.html.j2", recordings=shown, percent=_percent, number=_number, weights=_weights)


def write_diagnosis(document: Mapping[str, Any], path: Path) -> None:
    """Write the page; raises `BadInput` when that cannot be done."""
    try:
        path.write_text(diagnose_page(document), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None


def verdict_words(verdict: Mapping[str, Any]) -> str:
    """Return what a verdict amounts to in a few words."""
    if verdict["fault"]:
        return f"Fault: {verdict['fault']}"
    if verdict["first_detected_s"] is not None:
        return "A fault, cause open"
    return "Nothing is wrong" if verdict["trustworthy"] else "No answer"


def _percent(severity: Mapping[str, float] | None) -> str:
    return "–" if severity is None else f"{100 * severity['value']:.1f} ± {100 * severity['sd']:.1f} %"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _weights(weights: Mapping[str, float]) -> str:
    ranked = sorted(weights.items(), key=lambda item: -item[1])[:3]
    return ", ".join(f"{'none of these' if name == NONE else name} {100 * w:.3g} %" for name, w in ranked if w >= 0.001) or "–"


def _severities(recording: Mapping[str, Any]) -> str:
    """Return the severity of every decision against time, with bars of two standard errors; "" when there is none."""
    estimates: dict[str, list[tuple[float, float, float]]] = {}
    for burst in recording["bursts"]:
        for d in burst["decisions"]:
            if d["fault"] and d["severity"]:
                estimates.setdefault(d["fault"], []).append((d["seconds"], 100 * d["severity"]["value"], 200 * d["severity"]["sd"]))
    if not estimates:
        return ""
    figure = Figure(figsize=(8.5, 2.6), layout="constrained")
    ax = figure.subplots()
    for colour, (fault, rows) in zip(COLOURS * len(estimates), estimates.items(), strict=False):
        t, value, error = _columns(rows)
        ax.errorbar(t, value, yerr=error, fmt="o", ms=3.5, lw=1.0, color=colour, label=fault)
    ax.axhline(0.0, color="0.6", lw=0.8)
    ax.set_xlim(0.0, max(float(recording.get("watched_s") or 0.0), 1e-3))
    ax.set_xlabel("time [s]", fontsize=8)
    ax.set_ylabel("severity [% of gain or value]", fontsize=8)
    ax.tick_params(labelsize=7)
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


def _columns(rows: Sequence[tuple[float, float, float]]) -> tuple[list[float], list[float], list[float]]:
    return [r[0] for r in rows], [r[1] for r in rows], [r[2] for r in rows]
