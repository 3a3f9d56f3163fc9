"""What the functions of the Python interface hand back: the result, and how to look at it in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from afdsvc.api.model import Model
from afdsvc.errors import BadInput
from afdsvc.explain.check.result import CheckResult
from afdsvc.explain.report.explanation import Explanation
from afdsvc.identify.result import IdentifyResult
from afdsvc.lti.python_control import to_control

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, repr=False)
class Answer:
    """An answer: ``document`` holds what the command of the same name gives with ``--json``.

    ``print(answer)`` is a summary, a notebook shows it as a table with a picture.
    """

    document: Mapping[str, Any]
    COLUMNS: ClassVar[tuple[str, ...]] = ()  # of a table that may be without rows

    @property
    def sentences(self) -> tuple[str, ...]:
        """The answer in words, the most important first."""
        return ()

    def rows(self) -> list[dict[str, Any]]:
        """Return the table of the answer, a dict for each row."""
        return []

    def plot(self) -> Figure:
        """Return a picture of the answer; raises `BadInput` where there is nothing to show."""
        raise BadInput(f"this {type(self).__name__} holds nothing to plot; print it to see why")

    def to_pandas(self) -> Any:
        """Return the table of the answer as a ``pandas.DataFrame``; raises `BadInput` where pandas is not installed."""
        try:
            import pandas
        except ImportError:
            raise BadInput("pandas is not installed; expected it (pip install 'afdsvc[pandas]'), or use .rows()") from None
        return pandas.DataFrame(self.rows(), columns=list(self.COLUMNS) or None)

    def to_xarray(self) -> Any:
        """Return the answer as an ``xarray.Dataset``: its curves where it has some, else its table. Raises `BadInput` without the extra ``xarray``."""
        try:
            import xarray
        except ImportError:
            raise BadInput("xarray is not installed; expected the extra 'xarray' (afdsvc[xarray]), or use .rows()") from None
        return xarray.Dataset(*self._curves())

    def _curves(self) -> tuple[dict[str, tuple[Any, Any]], dict[str, Any]]:
        """Return variables as (dimensions, values), and coordinates."""
        rows = self.rows()
        return {name: ("row", [row[name] for row in rows]) for name in self.COLUMNS or (rows[0] if rows else ())}, {}

    def __repr__(self) -> str:
        return "\n".join([*self.sentences, *(f"  {_line(row)}" for row in self.rows())])

    def _repr_html_(self) -> str:
        from afdsvc.present.html import svg  # imports matplotlib

        try:
            picture = svg(self.plot())
        except BadInput:
            picture = ""
        return "".join(f"<p>{html.escape(s)}</p>" for s in self.sentences) + _html_table(self.rows()) + picture


@dataclass(frozen=True, slots=True, repr=False)
class Checked(Answer):
    """What `check` found: ``verdict`` is "ready", "limited" or "refused"."""

    result: CheckResult
    COLUMNS: ClassVar = ("output", "r2", "gain", "delay_s", "offset", "how")

    @property
    def verdict(self) -> str:
        """One of "ready", "limited", "refused"."""
        return self.result.verdict

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict, and what stops or limits an answer."""
        return (f"check: {self.verdict}", *(f.sentence for kind in ("stop", "warning") for f in self.result.findings if f.kind == kind))

    def rows(self) -> list[dict[str, Any]]:
        """Return measured against simulated, a row for each output."""
        return [{"output": c.output, "r2": c.r2, "gain": c.gain, "delay_s": c.delay, "offset": c.offset, "how": c.how} for c in self.result.outputs]

    def plot(self) -> Figure:
        """Return measured and simulated of every output."""
        from afdsvc.present.html.check_page import figure

        return figure(self.result) if self.result.outputs else Answer.plot(self)


@dataclass(frozen=True, slots=True, repr=False)
class Identified(Answer):
    """What `identify` found: ``model``, and ``system`` for python-control; ``result`` has bands, residual tests and the rest."""

    result: IdentifyResult
    nominal_given: bool = True

    @property
    def model(self) -> Model:
        """The identified model, ready for `check`, `explain` and `afdsvc.files.model.model_file.write_model`."""
        return self.result.model

    @property
    def system(self) -> Any:
        """The identified plant as ``control.StateSpace``."""
        return to_control(self.result.fit.system, self.result.fit.system.dt)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.result.fit.order

    @property
    def sentences(self) -> tuple[str, ...]:
        """Method and order, notes and warnings."""
        fit = self.result.fit
        return (f"identified by {fit.method}, order {fit.order}: {fit.order_reason}", *fit.notes, *(self.result.warnings if self.nominal_given else self.result.data))

    def rows(self) -> list[dict[str, Any]]:
        """Return the fit on data not used, a row for each output; ``r2`` is the coefficient of determination."""
        before = {name: {"r2_before": m.r2_classical} for name, m in self.result.before.items()} if self.nominal_given else {}
        return [{"output": name, **before.get(name, {}), "r2": m.r2_classical, "nrmse": m.nrmse} for name, m in self.result.after.items()]

    def _curves(self) -> tuple[dict[str, tuple[Any, Any]], dict[str, Any]]:
        """Frequency response, and the ends of its magnitude's 95 % band, against ``omega`` [rad/s], output and input."""
        from afdsvc.present.html.identify_page import response_band

        band, dims = response_band(self.result), ("omega", "output", "input")
        low, high = band.magnitude_band()
        names = {"output": [v.name for v in self.model.outputs], "input": [v.name for v in self.model.inputs]}
        return {"response": (dims, band.value), "magnitude_low": (dims, low), "magnitude_high": (dims, high)}, {"omega": band.omega, **names}

    def plot(self) -> Figure:
        """Return the frequency response with its 95 % band."""
        from afdsvc.present.html.identify_page import bode

        return bode(self.result, self.nominal_given)


@dataclass(frozen=True, slots=True, repr=False)
class Explained(Answer):
    """What `explain` found: ``verdict``, the named effects, and the improved model in ``result``."""

    result: Explanation
    COLUMNS: ClassVar = ("physics", "site", "weight", "parameter", "value", "sd", "unit")

    @property
    def verdict(self) -> str:
        """One of "consistent", "parameter_change", "omitted_physics", "unexplained", "insufficient_excitation"."""
        return self.result.verdict

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict, each name that is claimed, laws that come nearest where none is, and what limits the answer."""
        near = (f"not claimed: {n.sentence}" for n in self.result.candidates)
        return (f"explain: {self.verdict.replace('_', ' ')}", *(n.sentence for n in self.result.named), *near, *self.result.sentences)

    def rows(self) -> list[dict[str, Any]]:
        """Return the named effects, a row for each parameter."""
        return [
            {"physics": n.physics, "site": n.site, "weight": n.weight, "parameter": name, "value": e.value, "sd": e.sd, "unit": e.unit}
            for n in self.result.named for name, e in n.parameters.items()
        ]  # fmt: skip

    def _curves(self) -> tuple[dict[str, tuple[Any, Any]], dict[str, Any]]:
        """Measured, simulated before and after, against time [s] and output, of the first recording held out."""
        held = [c for c in self.result.courses if c.role == "heldout"]
        if not held:
            return Answer._curves(self)  # noqa: SLF001 - of this very class
        parts, dims = ("measured", "before", "after", "residual_before", "residual_after"), ("time", "output")
        names = [v.name for v in self.result.nominal.model.outputs]
        return {part: (dims, getattr(held[0], part)) for part in parts}, {"time": held[0].t, "output": names}

    def plot(self) -> Figure:
        """Return a held-out recording: measured, simulated before and after, and both residuals."""
        from afdsvc.present.html.explain_page import course_figure

        return course_figure(self.result) or Answer.plot(self)


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosed(Answer):
    """What `diagnose` found, one verdict for each recording of a machine."""

    COLUMNS: ClassVar = ("recording", "machine", "start_s", "detector", "detected", "statistic", "threshold", "fault", "severity", "sd")

    @property
    def sentences(self) -> tuple[str, ...]:
        """A verdict for each recording."""
        return tuple(f"{r['recording']}: {_verdict(r['verdict'])}" for r in self.document["recordings"])

    def rows(self) -> list[dict[str, Any]]:
        """Return every decision, a row for each detector and burst."""
        return [
            {"recording": r["recording"], "machine": r["machine"], "start_s": b["start_s"], "detector": d["detector"], "detected": d["detected"],
             "statistic": d["statistic"], "threshold": d["threshold"], "fault": d["fault"],
             "severity": (d["severity"] or {}).get("value"), "sd": (d["severity"] or {}).get("sd")}
            for r in self.document["recordings"] for b in r["bursts"] for d in b["decisions"]
        ]  # fmt: skip

    def plot(self) -> Figure:
        """Return every decision's statistic over its threshold against time."""
        rows = [r for r in self.rows() if r["threshold"] and r["statistic"] is not None]
        if not rows:
            return Answer.plot(self)
        figure, ax = _axes()
        for name in dict.fromkeys(r["detector"] for r in rows):
            own = [r for r in rows if r["detector"] == name]
            ax.semilogy([r["start_s"] for r in own], [max(r["statistic"] / r["threshold"], 1e-3) for r in own], "o-", ms=4, lw=0.8, label=name)
        ax.axhline(1.0, color="0.25", lw=0.8)
        ax.set_xlabel("time [s]")
        ax.set_ylabel("statistic over threshold")
        ax.legend(fontsize=8, frameon=False)
        return figure


@dataclass(frozen=True, slots=True, repr=False)
class Designed(Answer):
    """The design sheet of a machine; ``page`` is the HTML page of it."""

    page: str

    @property
    def sentences(self) -> tuple[str, ...]:
        """The burst, and how often it is wrong."""
        return (f"design of {self.document['machine']}: {self.document['false_alarms_per_hour']:.3g} false alarms per hour",)

    def rows(self) -> list[dict[str, Any]]:
        """Return every fault, a row each."""
        names = ("fault", "severity", "gain", "phase_deg", "p_detect", "smallest_detectable", "cramer_rao_sd")
        return [{name: f.get(name) for name in names} for f in self.document["faults"]]

    def plot(self) -> Figure:
        """Return the smallest detectable severity of every fault."""
        rows = [r for r in self.rows() if r["smallest_detectable"] is not None]
        figure, ax = _axes()
        ax.barh([r["fault"] for r in rows], [100 * abs(r["smallest_detectable"]) for r in rows], color="#1b6ca8")
        ax.set_xlabel("smallest detectable loss [%]")
        return figure


def _axes() -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 2.8), layout="constrained")
    return figure, figure.subplots()


def _verdict(verdict: Mapping[str, Any]) -> str:
    if verdict["first_detected_s"] is None:
        return "no fault" if verdict["trustworthy"] else f"not trustworthy: {verdict['reason']}"
    if verdict["fault"] is None:
        return "something differs, no known fault fits"
    size = verdict["severity"]
    return f"{verdict['fault']} {100 * size['value']:+.1f} ± {100 * size['sd']:.1f} %, first detected at {verdict['first_detected_s']:.1f} s"


def _line(row: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {_short(value)}" for name, value in row.items() if value is not None)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)


def _html_table(rows: Iterable[Mapping[str, Any]]) -> str:
    listed = list(rows)
    if not listed:
        return ""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in listed[0])
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(_short(v))}</td>' for v in row.values())}</tr>" for row in listed)
    return f"<table><tr>{head}</tr>{body}</table>"
