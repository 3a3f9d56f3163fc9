"""Decisions for the viewer: statistic and threshold, marks of alarms and untrusted decisions, lanes of verdicts."""

from __future__ import annotations

import rerun as rr

from afdsvc.api.evidence import Evidence
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.paths import Columns, at
from afdsvc.wire.messages import Finding


class Lane:
    """One coloured lane. States are named as they come; the same state twice is one band."""

    def __init__(self, entity: str) -> None:
        self.entity = entity
        self._colors: dict[str, tuple[int, int, int]] = {}
        self._now = ""

    def enter(
        self, recording: rr.RecordingStream, t_ns: int, start_ns: int, state: str, color: tuple[int, int, int]
    ) -> None:
        """Begin a state; "" ends the one before and leaves a gap."""
        if state == self._now:
            return
        if state and self._colors.get(state) != color:
            self._colors[state] = color
            values, colors = list(self._colors), list(self._colors.values())
            recording.log(self.entity, rr.StateConfiguration(values=values, colors=colors), static=True)
        at(recording, t_ns, start_ns)
        recording.log(self.entity, rr.StateChange(state=state))
        self._now = state


ALL = "all outputs"


class DetectorTrack:
    """What one detector says about one output of a machine, over time."""

    def __init__(self, recording: rr.RecordingStream, machine: str, evidence: Evidence, number: int) -> None:
        e, label = evidence, evidence.output or ALL
        entity = paths.decision(machine, e.detector, label)
        color = paths.LINES[number % len(paths.LINES)]
        self._statistic = _line(recording, entity, f"statistic, {label}", color)
        self._threshold = _line(recording, f"{entity}/threshold", f"threshold, {label}", paths.THRESHOLD)
        # A plot shows the range of its data: without this line one decision would be a dot in the middle of nowhere.
        self._zero = _line(recording, f"{entity}/_zero", "0", paths.ZERO)
        self._begun = False
        self._marks = {
            name: _mark(recording, f"{entity}/{name}", words, mark, shape)
            for name, words, mark, shape in (
                ("alarm", f"detected, {label}", paths.ALARM, "Diamond"),
                ("doubt", f"not trustworthy, {label}", paths.DOUBT, "Cross"),
                ("quiet", f"nothing found, {label}", color, "Circle"),
            )
        }
        self._lane = Lane(paths.lane(machine, e.detector + (f"_{e.output}" if e.output else "")))

    def add(self, recording: rr.RecordingStream, finding: Finding, start_ns: int) -> None:
        """Take a decision."""
        e = finding.evidence
        for t_ns in (finding.t_ns,) if self._begun else (start_ns, finding.t_ns):
            self._threshold.add_row(t_ns, e.threshold)
            self._zero.add_row(t_ns, 0.0)
        self._begun = True
        self._statistic.add_row(finding.t_ns, e.statistic)
        self._marks[_kind(e)].add_row(finding.t_ns, e.statistic)
        self._lane.enter(recording, finding.t_ns, start_ns, *_verdict(e))

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send what was collected."""
        for columns in (self._statistic, self._threshold, self._zero, *self._marks.values()):
            columns.send(recording, start_ns)


def _line(recording: rr.RecordingStream, entity: str, name: str, color: tuple[int, int, int]) -> Columns:
    recording.log(entity, rr.SeriesLines(names=name, colors=[color], widths=[1.5]), static=True)
    return Columns(entity, 1)


def _mark(
    recording: rr.RecordingStream, entity: str, name: str, color: tuple[int, int, int], shape: str
) -> Columns:
    points = rr.SeriesPoints(names=name, colors=[color], markers=shape, marker_sizes=[4.0])  # type: ignore[arg-type]
    recording.log(entity, points, static=True)
    return Columns(entity, 1)


def _kind(evidence: Evidence) -> str:
    if not evidence.trustworthy:
        return "doubt"
    return "alarm" if evidence.detected else "quiet"


def _verdict(evidence: Evidence) -> tuple[str, tuple[int, int, int]]:
    """Return the words and the colour of a decision in the lane of verdicts."""
    kind = _kind(evidence)
    if kind == "doubt":
        return "not trustworthy", paths.DOUBT
    if kind == "quiet":
        return "quiet", paths.QUIET
    return (evidence.fault, paths.ALARM) if evidence.fault else ("detected, cause open", paths.OPEN)
