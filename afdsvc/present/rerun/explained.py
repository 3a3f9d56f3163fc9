"""An explanation in Rerun: every recording measured and simulated, the residual before and after, and the verdict."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from afdsvc.errors import BadInput
from afdsvc.explain.report.explanation import Explanation, RecordingCourse
from afdsvc.lti.statespace import Array
from afdsvc.present.rerun.blueprint import whole_range
from afdsvc.present.rerun.paths import APPLICATION, SECONDS

COLOURS = {"measured": (150, 150, 150), "before": (217, 108, 76), "after": (72, 158, 214)}
ORDER = {"measured": "a_", "before": "b_", "after": "c_"}  # the viewer draws in the order of the alphabet


def log_explanation(explanation: Explanation, path: Path) -> None:
    """Write a Rerun file; raises `BadInput` when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None
    recording = rr.RecordingStream(APPLICATION, recording_id=str(uuid.uuid4()))
    recording.set_sinks(rr.FileSink(path))
    recording.send_recording_name(f"why {explanation.nominal.model.name} is wrong")
    ordered = sorted(explanation.courses, key=lambda c: c.role != "heldout")
    labels = {_label(c, i): c for i, c in enumerate(ordered, 1)}
    names = [v.name for v in explanation.nominal.model.outputs]
    for label, course in labels.items():
        _course(recording, label, course, names)
    recording.log("verdict", rr.TextDocument(_words(explanation), media_type=rr.MediaType.MARKDOWN), static=True)
    recording.send_blueprint(_layout(labels, names, [v.unit for v in explanation.nominal.model.outputs]))
    recording.flush()
    recording.disconnect()


def _label(course: RecordingCourse, number: int) -> str:
    return f"{number}_{''.join(c if c.isalnum() else '_' for c in course.name)}"


def _course(recording: rr.RecordingStream, label: str, course: RecordingCourse, names: list[str]) -> None:
    t = course.t - course.t[0]
    for j, name in enumerate(names):
        for what, values in (("measured", course.measured), ("before", course.before), ("after", course.after)):
            _series(recording, f"{label}/outputs/{name}/{ORDER[what]}{what}", t, values[:, j], what)
        for what, values in (("before", course.residual_before), ("after", course.residual_after)):
            _series(recording, f"{label}/residual/{name}/{ORDER[what]}{what}", t, values[:, j], what)


def _series(recording: rr.RecordingStream, path: str, t: Array, values: Array, what: str) -> None:
    style = rr.SeriesLines(names=[what], colors=[COLOURS[what]], aggregation_policy=rr.components.AggregationPolicy.MinMax)
    recording.log(path, style, static=True)
    seen = np.isfinite(values)
    recording.send_columns(
        path, indexes=[rr.TimeColumn(SECONDS, duration=t[seen])], columns=rr.Scalars.columns(scalars=values[seen])
    )


def _words(e: Explanation) -> str:
    named = "\n".join(f"- {n.sentence}" for n in e.named) or "\n".join(f"- not claimed: {c.sentence}" for c in e.candidates)
    fit = "\n".join(f"- {f.output}: error {100 * f.before_nrmse:.3g} % before, {100 * f.after_nrmse:.3g} % after" for f in e.fit)
    where = "\n".join(f"- {p.evidence}" for p in e.located[:6])
    said = "\n\n".join(e.sentences)
    return f"# {e.verdict.replace('_', ' ')}\n\n{said}\n\n{named}\n\n## Held-out fit\n\n{fit}\n\n## Located\n\n{where}\n"


def _layout(labels: Mapping[str, RecordingCourse], names: list[str], units: list[str]) -> rrb.Blueprint:
    tabs = [_tab(label, course, names, units) for label, course in labels.items()]
    words = rrb.TextDocumentView(origin="verdict", name="verdict")
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Tabs(*tabs), words, column_shares=[2.4, 1.0]),
        rrb.TimePanel(state="collapsed", timeline=SECONDS), rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"),
        auto_views=False, auto_layout=False,
    )


def _tab(label: str, course: RecordingCourse, names: list[str], units: list[str]) -> rrb.Container:
    rows = []
    for name, unit in zip(names, units, strict=True):
        for what in ("outputs", "residual"):
            title = f"{what.removesuffix('s')}: {name}" + (f" [{unit}]" if unit else "")
            rows.append(rrb.TimeSeriesView(origin=f"{label}/{what}/{name}", name=title, axis_x=whole_range(), plot_legend=rrb.Corner2D.LeftTop))
    return rrb.Vertical(*rows, name=f"{course.name} ({course.role})")
