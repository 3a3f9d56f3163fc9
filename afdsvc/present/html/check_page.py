"""A check as one self-contained HTML page: what forbids or limits an answer first, then measured beside simulated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from afdsvc import __version__
from afdsvc.explain.check.result import CheckResult
from afdsvc.present.html import render, zoomable
from afdsvc.present.html.explain_page import BEFORE, MEASURED, SHOWN
from afdsvc.present.text_plot import close_up

VERDICTS = {
    "ready": "Model and recordings fit together: nothing stands in the way of an answer.",
    "limited": "Model and recordings fit together; what limits the answer is listed below.",
    "refused": "Model and recordings do not fit together: mend what is listed first.",
}
KINDS = {"stop": "stops", "warning": "limits", "ok": "holds"}


def check_page(result: CheckResult, document: Mapping[str, Any]) -> str:
    """Return the page; ``document`` is what ``check --json`` says of it."""
    order = sorted(document["findings"], key=lambda f: list(KINDS).index(f["kind"]))
    return render(
        "check_page.html.j2", document=document, name=result.model.name, verdict=VERDICTS[result.verdict], findings=order, kinds=KINDS,
        picture=zoomable(figure(result)) if result.outputs else "", version=__version__,
    )  # fmt: skip


def figure(result: CheckResult) -> Figure:
    """Return measured and simulated of every output, a close-up of where they differ most."""
    figure = Figure(figsize=(9.5, 2.2 * len(result.outputs)), layout="constrained")
    for ax, c in zip(figure.subplots(len(result.outputs), 1, squeeze=False)[:, 0], result.outputs, strict=True):
        part = close_up(c.measured, c.simulated, SHOWN)
        ax.plot(c.t[part], c.measured[part], color=MEASURED, lw=1.6, label="measured")
        ax.plot(c.t[part], c.simulated[part], color=BEFORE, lw=0.9, label="simulated by the model as stated")
        ax.set_ylabel(f"{c.output} [{c.unit}]" if c.unit else c.output, fontsize=8)
        ax.set_xlabel("time [s]", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.grid(alpha=0.25, lw=0.5)
        ax.legend(fontsize=7, frameon=False, ncols=2, loc="upper left")
    return figure
