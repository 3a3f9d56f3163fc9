"""An explanation as one self-contained HTML page that prints well: the verdict first, then the evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape

from afdsvc import __version__
from afdsvc.explain.report.explanation import Explanation
from afdsvc.present.html import explain_pictures

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
    page = Environment(loader=PackageLoader("afdsvc.present.html", "."), autoescape=select_autoescape(["j2"]))
    page.filters["digits"] = digits
    page.filters["percent"] = percent
    page.filters["place"] = place
    return page.get_template("explain_page.html.j2").render(
        e=explanation, document=document, verdict=verdict_sentence(document), effects=_effects(document),
        courses=explain_pictures.courses(explanation), spectra=explain_pictures.spectra(explanation),
        law=explain_pictures.law(explanation),
        softw=", ".join(f"{name} {version(name)}" for name in LIBRARIES), version=__version__,
    )


def verdict_sentence(document: Mapping[str, Any]) -> str:
    """Return the verdict as one plain sentence."""
    first = [named[0] for named in _effects(document).values()]
    told = " and ".join(f"{n['parameter'] or n['physics'].replace('_', ' ')} ({place(n['site'])})" for n in map(_with_parameter, first))
    return VERDICTS[document["verdict"]].format(names=told or "see below")


def _with_parameter(named: Mapping[str, Any]) -> dict[str, Any]:
    change = named["physics"] == "parameter_change"
    return {**named, "parameter": ", ".join(named["parameters"]) if change else ""}


def _effects(document: Mapping[str, Any]) -> dict[int, list[dict[str, Any]]]:
    """Return the named entries by effect, likeliest first within each."""
    found: dict[int, list[dict[str, Any]]] = {}
    for named in document["named"]:
        found.setdefault(int(named.get("effect", 1)), []).append(named)
    return found


def place(site: str) -> str:
    """Return a site in words."""
    kind, _, name = site.partition(":")
    return {"input": f"input {name}", "state": f"force on {name}", "output": f"sensor {name}"}.get(kind, site)


def digits(value: float | None, count: int = 3) -> str:
    """Return a number in a few digits, a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{count}g}"


def percent(value: float | None) -> str:
    """Return a share in percent, a dash for none."""
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:.1f} %" if abs(value) < 10 else f"{value:.3g} times"
