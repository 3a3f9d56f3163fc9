"""An explanation as one self-contained HTML page that prints well: the verdict first, then the evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from afdsvc import __version__
from afdsvc.api.physics import site_words
from afdsvc.explain.report.explanation import Explanation, RecordingCourse, Spectrum
from afdsvc.lti.statespace import Array
from afdsvc.present.html import render, zoomable

MEASURED, BEFORE, AFTER, NOISE = "0.25", "#c8553d", "#1b6ca8", "#4a9c5d"
SHOWN = 1200  # samples of a close-up
BANDS = 60  # bands per decade of a spectrum


def _courses(explanation: Explanation) -> str:
    """Return the held-out recording as an SVG element."""
    figure = course_figure(explanation)
    return zoomable(figure) if figure else ""


def course_figure(explanation: Explanation) -> Figure | None:
    """Return the held-out recording: a close-up of measured and simulated, and the residual over the whole of it; None without one."""
    held = [c for c in explanation.courses if c.role == "heldout"]
    if not held:
        return None
    course, names = held[0], _outputs(explanation)
    figure, axes = _axes(2 * len(names), 1, 1.7)
    close = _close_up(course)
    for j, name in enumerate(names):
        _compared(axes[2 * j], course, close, j, name)
        _residual(axes[2 * j + 1], course, j, name)
    _legend(axes[0])
    _legend(axes[1])
    axes[-1].set_xlabel(f"time [s], {course.name}", fontsize=8)
    return figure


def _compared(ax: Axes, course: RecordingCourse, part: slice, j: int, name: str) -> None:
    ax.plot(course.t[part], course.measured[part, j], color=MEASURED, lw=1.6, label="measured")
    ax.plot(course.t[part], course.before[part, j], color=BEFORE, lw=0.9, label="simulated before")
    ax.plot(course.t[part], course.after[part, j], color=AFTER, lw=0.9, ls="--", label="simulated after")
    _labelled(ax, name)


def _residual(ax: Axes, course: RecordingCourse, j: int, name: str) -> None:
    step = max(len(course.t) // 6000, 1)
    ax.plot(course.t[::step], course.residual_before[::step, j], color=BEFORE, lw=0.6, label="residual before")
    ax.plot(course.t[::step], course.residual_after[::step, j], color=AFTER, lw=0.6, label="residual after")
    _labelled(ax, f"residual {name}")


def _spectra(explanation: Explanation) -> str:
    """Return the residual's power density before and after, with the noise where it is known apart from the model."""
    if not explanation.spectra:
        return ""
    figure, axes = _axes(len(explanation.spectra), 1, 2.4)
    for ax, s in zip(axes, explanation.spectra, strict=True):
        unit = next((v.unit for v in explanation.nominal.model.outputs if v.name == s.output), "")
        _density(ax, s, f"{s.output} [({unit})²/Hz]" if unit else f"{s.output} [1/Hz]")
    _legend(axes[0])
    axes[-1].set_xlabel("frequency [Hz]", fontsize=8)
    return zoomable(figure)


def _law(explanation: Explanation) -> str:
    """Return the free-form law with its band, and the named law beside it."""
    found = explanation.law
    if found is None:
        return ""
    figure, (ax,) = _axes(1, 1, 3.2)
    ax.fill_between(found.x, found.low, found.high, color=AFTER, alpha=0.2, lw=0, label="95 % band")
    ax.plot(found.x, found.y, "o-", color=AFTER, lw=1.3, ms=3, label="free-form law")
    if found.named_y is not None:
        ax.plot(found.x, found.named_y, color=BEFORE, lw=1.3, ls="--", label="named law")
    ax.axhline(0.0, color=MEASURED, lw=0.5)
    ax.set_xlabel(f"{found.against} [{found.x_unit}]" if found.x_unit else found.against, fontsize=8)
    _labelled(ax, f"{found.site} [{found.unit}]" if found.unit else found.site)
    ax.legend(fontsize=7, frameon=False)
    return zoomable(figure)


def _density(ax: Axes, s: Spectrum, name: str) -> None:
    for values, colour, words, width in (
        (s.measured, MEASURED, "measured output", 0.7), (s.before, BEFORE, "residual before", 1.3),
        (s.after, AFTER, "residual after", 1.3), (s.noise, NOISE, "what does not repeat (noise)", 1.0),
    ):
        if values is not None:
            ax.loglog(*_averaged(s.frequency, values), color=colour, lw=width, label=words)
    _labelled(ax, name)
    floor = float(_averaged(s.frequency, s.after)[1].min())
    if floor > 0:
        ax.set_ylim(bottom=floor / 5)


def _averaged(frequency: Array, density: Array) -> tuple[Array, Array]:
    """Return the density averaged over bands that are as wide on a logarithmic axis, so that lines do not hide one another."""
    seen = frequency > 0
    f, d = frequency[seen], density[seen]
    band = np.unique(np.floor(BANDS * np.log10(f)), return_inverse=True)[1]
    count = np.bincount(band)
    return np.bincount(band, f) / count, np.maximum(np.bincount(band, d) / count, 1e-300)


def _close_up(course: RecordingCourse) -> slice:
    """Return the stretch where before and after differ most."""
    n = len(course.t)
    if n <= SHOWN:
        return slice(0, n)
    apart = np.nan_to_num((course.before - course.after) / np.maximum(np.nanstd(course.measured, axis=0), 1e-300))
    power = np.concatenate([[0.0], np.cumsum((apart**2).sum(1))])
    start = int(np.argmax(power[SHOWN:] - power[:-SHOWN]))
    return slice(start, start + SHOWN)


def _outputs(explanation: Explanation) -> list[str]:
    return [f"{v.name} [{v.unit}]" if v.unit else v.name for v in explanation.nominal.model.outputs]


def _legend(ax: Axes) -> None:
    """Draw a legend above the axes, where it hides no curve."""
    ax.legend(fontsize=7, frameon=False, ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)


def _labelled(ax: Axes, name: str) -> None:
    ax.set_ylabel(name, fontsize=8)
    ax.tick_params(labelsize=7)
    ax.grid(alpha=0.25, lw=0.5)


def _axes(rows: int, columns: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=(9.5, height * rows), layout="constrained")
    return figure, list(np.atleast_1d(figure.subplots(rows, columns)).ravel())


VERDICTS = {
    "consistent": "Simulation and recordings agree: the residual is consistent with noise.",
    "parameter_change": "No physics is missing; a parameter differs from its stated value: {names}.",
    "omitted_physics": "The model leaves out physics that the recordings show: {names}.",
    "unexplained": "Simulation and recordings differ, and no hypothesis of the library explains it well enough to be named.",
    "insufficient_excitation": "These recordings do not excite the machine enough for an answer.",
}
LIBRARIES = ("numpy", "scipy", "numba")


def explain_page(explanation: Explanation, document: Mapping[str, Any]) -> str:
    """Return the page; ``document`` is what ``explain --json`` says of it."""
    return render(
        "explain_page.html.j2", {"digits": _digits, "percent": _percent, "place": site_words}, e=explanation, document=document, verdict=_verdict_sentence(document), effects=_effects(document),
        courses=_courses(explanation), spectra=_spectra(explanation), noise_known=any(s.noise is not None for s in explanation.spectra),
        law=_law(explanation),
        softw=", ".join(f"{name} {version(name)}" for name in LIBRARIES), version=__version__,
    )


def _verdict_sentence(document: Mapping[str, Any]) -> str:
    """Return the verdict as one plain sentence."""
    names = " and ".join(map(_alternatives, _effects(document).values()))
    return VERDICTS[document["verdict"]].format(names=names or "see below")


def _alternatives(effect: Sequence[Mapping[str, Any]]) -> str:
    """Return the names of one effect, which the recordings do not distinguish, by the places where they act."""
    places: dict[str, list[str]] = {}
    for n in effect:
        places.setdefault(site_words(n["site"]), []).append(", ".join(n["parameters"]) if n["physics"] == "parameter_change" else n["physics"].replace("_", " "))
    return " or ".join(f"{' or '.join(names)} ({place})" for place, names in places.items())


def _effects(document: Mapping[str, Any]) -> dict[int, list[dict[str, Any]]]:
    """Return the named entries by effect, likeliest first within each."""
    found: dict[int, list[dict[str, Any]]] = {}
    for named in document["named"]:
        found.setdefault(int(named.get("effect", 1)), []).append(named)
    return found


def _digits(value: float | None, count: int = 3) -> str:
    """Return a number in a few digits, a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{count}g}"


def _percent(value: float | None) -> str:
    """Return a share in percent, a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:z.1f} %" if abs(value) < 10 else f"{value:.3g} times"
