"""Severity per fault over months, from the decisions of many recordings."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from afdsvc.api.evidence import Evidence
from afdsvc.diagnosis.verdict import alarm_decisions, strongest
from afdsvc.errors import BadInput
from afdsvc.files.recording import mcap_file
from afdsvc.files.recording.reader import messages_on
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.blueprint import whole_range
from afdsvc.present.rerun.paths import Columns
from afdsvc.wire import codec
from afdsvc.wire.messages import Finding

Row = tuple[int, str, float, float]  # Unix time [ns], fault, severity, its standard error


def severities(recordings: Iterable[Path]) -> dict[str, list[Row]]:
    """Return the decision on each burst of every machine, in order of time; an unreadable recording is named in `BadInput`.

    Only the chunks that hold decisions are read, found by the recordings' index. A burst without a detected fault has an empty name
    and severity 0: it is part of the history too.
    """
    bursts: dict[tuple[str, str], list[Finding]] = {}
    for path in recordings:
        for data in messages_on(path, mcap_file.FINDING):
            finding = codec.decode(Finding, data)
            if finding.evidence.burst:
                bursts.setdefault((finding.evidence.machine, finding.session + finding.evidence.burst), []).append(finding)
    found: dict[str, list[Row]] = {}
    for (machine, _), findings in bursts.items():
        reported = _reported(findings)
        if reported is not None:
            found.setdefault(machine, []).append(reported)
    return {machine: sorted(rows) for machine, rows in sorted(found.items())}


def _reported(findings: Sequence[Finding]) -> Row | None:
    """Return what the decisions on one burst amount to; None when none of them could be trusted."""
    evidence: list[Evidence] = [f.evidence for f in findings]
    if not any(e.trustworthy for e in evidence):
        return None
    best, t_ns = strongest(alarm_decisions(evidence)), findings[-1].t_ns
    if best is None or best.fault is None:
        return t_ns, "", 0.0, 0.0
    return (t_ns, best.fault, best.severity.value, best.severity.sd) if best.severity else (t_ns, best.fault, float("nan"), 0.0)


def review_history(recordings: Sequence[Path], save: Path) -> Path:
    """Write a Rerun file of the history, one plot per machine; raises `BadInput` when no decision is in any recording."""
    found = severities(recordings)
    if not found:
        raise BadInput(f"{len(recordings)} recording(s) hold no decision on any burst; recordings of a service hold some")
    try:
        save.parent.mkdir(parents=True, exist_ok=True)
        save.open("wb").close()
    except OSError as error:
        raise BadInput(f"{save}: cannot be written: {error.strerror or error}") from None
    recording = rr.RecordingStream(paths.APPLICATION, recording_id=str(uuid.uuid4()))
    recording.set_sinks(rr.FileSink(save))
    recording.send_recording_name("history")
    start = min(rows[0][0] for rows in found.values())
    for machine, rows in found.items():
        _machine(recording, machine, rows, start)
    recording.send_blueprint(_layout(list(found)))
    recording.flush()
    recording.disconnect()
    return save


def _machine(recording: rr.RecordingStream, machine: str, rows: Sequence[Row], start: int) -> None:
    """Log a line with points for every fault, two standard errors around it, and one at 0 for bursts that found nothing."""
    names = sorted({fault for _, fault, *_ in rows})
    for fault in names:
        shown, colour = (fault, paths.fault_colour(fault)) if fault else ("nothing found", paths.QUIET)
        own = [row for row in rows if row[1] == fault and row[2] == row[2]]
        for kind, sign in (("", 0.0), ("_low", -2.0), ("_high", 2.0)) if fault else (("", 0.0),):
            entity = paths.path(machine, "history", (fault or "_nothing") + kind)
            if not kind:
                recording.log(entity, rr.SeriesPoints(names=shown, colors=[colour], markers="Circle", marker_sizes=[2.5]), static=True)
            if fault:
                name = shown if not kind else f"{shown}, 2 standard errors"
                recording.log(entity, rr.SeriesLines(names=name, colors=[colour], widths=[0.7 if kind else 1.5]), static=True)
            line = Columns(entity, 1)
            for t_ns, _, value, sd in own:
                line.add_row(t_ns, 100 * (value + sign * sd))
            line.send(recording, start)


def _layout(machines: Sequence[str]) -> rrb.Blueprint:
    views = [
        rrb.TimeSeriesView(
            origin=paths.path(machine, "history"), name=f"{machine}: severity of each fault [% of its gain or value]",
            axis_x=whole_range(), plot_legend=rrb.Corner2D.LeftBottom,
        )
        for machine in machines
    ]  # fmt: skip
    return rrb.Blueprint(
        rrb.Vertical(*views), rrb.TimePanel(state="collapsed", timeline=paths.CLOCK), rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"), auto_views=False, auto_layout=False,
    )
