"""What is shown of one machine: its groups of signals, its bursts, its detectors: statistic and threshold, marks of alarms, lanes of verdicts."""

from __future__ import annotations

import datetime
from collections import Counter, deque

import numpy as np
import rerun as rr

from afdsvc.api.evidence import Evidence
from afdsvc.api.signals import Block
from afdsvc.detect.isolation import NONE
from afdsvc.diagnosis.verdict import FaultVerdict, conclude
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.blueprint import MachineLayout
from afdsvc.present.rerun.paths import Columns, at
from afdsvc.present.rerun.signals import Groups, SignalGroup
from afdsvc.wire.messages import Finding

KEPT = 400


class MachineAnswers:
    """What the decisions on one machine amount to, as words and as severity and weight per fault over time."""

    def __init__(self, machine: str) -> None:
        self._machine = machine
        self._evidence: deque[Evidence] = deque(maxlen=KEPT)
        self._lines: dict[tuple[str, str], Columns] = {}
        self._begun_ns: int | None = None
        self._words, self._said = "", False
        self.bursts = 0

    @property
    def severities(self) -> bool:
        """Whether a severity has been estimated."""
        return any(kind == "severity" for kind, _ in self._lines)

    def say_nothing_yet(self, recording: rr.RecordingStream, t_ns: int, start_ns: int) -> None:
        """Answer before the first decision."""
        if not self._words:
            self._show(recording, "## No decision yet\n\nNo detector has made a decision so far.", t_ns, start_ns)

    def take(self, recording: rr.RecordingStream, finding: Finding, start_ns: int) -> None:
        """Take a decision; a changed answer is shown again."""
        self._evidence.append(finding.evidence)
        verdict = conclude(list(self._evidence))
        if verdict.detected and self._begun_ns is None:
            self._begun_ns = finding.t_ns
        self._said = self._said or verdict.fault is not None  # an early decision, which names nothing yet, is not a step back
        if verdict.fault and verdict.severity:
            s = verdict.severity
            for kind, value in (("", s.value), ("_low", s.value - 2 * s.sd), ("_high", s.value + 2 * s.sd)):
                self._line(recording, "severity", verdict.fault + kind).add_row(finding.t_ns, 100 * value)
        for fault in () if self._said and not finding.evidence.severity else self._reported() | {name for name, weight in verdict.weights.items() if weight >= 0.01}:
            self._line(recording, "sure", fault).add_row(finding.t_ns, 100 * verdict.weights.get(fault, 0.0))
        self._show(recording, _words(verdict, list(self._evidence), self._begun_ns, start_ns), finding.t_ns, start_ns)

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send what was collected."""
        for columns in self._lines.values():
            columns.send(recording, start_ns)

    def _reported(self) -> set[str]:
        return {name for kind, name in self._lines if kind == "sure"}

    def _line(self, recording: rr.RecordingStream, kind: str, name: str) -> Columns:
        key = (kind, name)
        if key not in self._lines:
            entity = paths.path(self._machine, kind, name)
            fault = name.removesuffix("_low").removesuffix("_high")
            color = paths.fault_colour(fault)
            main = fault == name
            shown = fault if main else f"{fault}, 2 standard errors"
            recording.log(entity, rr.SeriesLines(names=shown, colors=[color], widths=[2.0 if main else 0.7]), static=True)
            if main:
                points = rr.SeriesPoints(names=shown, colors=[color], markers="Circle", marker_sizes=[3.0])
                recording.log(entity, points, static=True)
            self._lines[key] = Columns(entity, 1)
        return self._lines[key]

    def _show(self, recording: rr.RecordingStream, words: str, t_ns: int, start_ns: int) -> None:
        if words == self._words:
            return
        self._words = words
        at(recording, t_ns, start_ns)
        recording.log(paths.path(self._machine, "answer"), rr.TextDocument(words, media_type=rr.MediaType.MARKDOWN))


def _words(verdict: FaultVerdict, evidence: list[Evidence], begun_ns: int | None, start_ns: int) -> str:
    """Return the answers as Markdown."""
    if not verdict.detected:
        if not verdict.trustworthy:
            return f"## No answer\n\n{verdict.reason}"
        return f"## Nothing is wrong\n\n{_looked(evidence)}"
    since = f"{(begun_ns - start_ns) / 1e9:.1f} s, {_clock(begun_ns)}" if begun_ns is not None else "unknown"
    lines = [f"## {'Fault: ' + verdict.fault if verdict.fault else 'A fault, cause open'}", f"**Since** {since}"]
    lines.append(f"**Which part** {verdict.fault or ' or '.join(_likely(verdict))}")
    if verdict.severity:
        lines.append(f"**How severe** {100 * verdict.severity.value:.1f} % (±{100 * verdict.severity.sd:.1f} %) of its gain or value")
    lines.append(f"**How sure** {_sure(verdict)}; {_looked(evidence)}")
    return "\n\n".join(lines)


def _likely(verdict: FaultVerdict) -> list[str]:
    ranked = sorted(verdict.weights, key=lambda name: -verdict.weights[name])
    return [name for name in ranked if name != NONE][:3] or ["not singled out yet"]


def _sure(verdict: FaultVerdict) -> str:
    ranked = sorted(verdict.weights.items(), key=lambda item: -item[1])[:3]
    shares = [f"{'none of these' if name == NONE else name} {100 * w:.3g} %" for name, w in ranked if w >= 0.005]
    return ", ".join(shares) or "detected, without weights"


def _looked(evidence: list[Evidence]) -> str:
    """Return how many bursts and detectors stand behind the answer."""
    newest = next((e.burst for e in reversed(evidence) if e.burst), "")
    last = [e for e in evidence if e.burst == newest] if newest else evidence[-1:]
    for_it = sum(e.detected and e.trustworthy for e in last)
    count = len({e.burst for e in evidence if e.burst})
    bursts = f"{count} burst{'' if count == 1 else 's'} judged"
    return f"{for_it} of {len(last)} decisions on the last burst agree ({bursts})" if for_it else f"{bursts}, nothing found in the last"


def _clock(t_ns: int) -> str:
    return f"{datetime.datetime.fromtimestamp(t_ns / 1e9, datetime.UTC):%Y-%m-%d %H:%M:%S} UTC"


class MachineReview:
    """Collects what belongs to one machine and sends it on request."""

    def __init__(self, id: str, quiet_hertz: float) -> None:
        self.id, self._quiet = id, quiet_hertz
        self.groups: dict[str, SignalGroup] = {}
        self.expected: dict[str, tuple[float, float]] = {}
        self._tracks: dict[tuple[str, str], DetectorTrack] = {}
        self._lanes: dict[str, Lane] = {}
        self._tuning = ""
        self._burst: tuple[str, int] = ("", 0)
        self._end = ("", 0)
        self._end_ns = 0
        self.reported = False
        self.answers = MachineAnswers(id)
        self.planes: tuple[tuple[str, float], ...] = ()

    def show(self, recording: rr.RecordingStream, block: Block, groups: Groups, start_ns: int) -> None:
        """Take samples by group and role."""
        for name, channels in groups.items():
            if name not in self.groups:
                self.groups[name] = SignalGroup(self.id, name, self._quiet)
                self.groups[name].extremes = self.expected.get(name, (np.inf, -np.inf))
            group = self.groups[name]
            if group.channels != channels:
                group.send(recording, start_ns)
                group.style(recording, channels)
            group.add(block)

    def follow_burst(self, recording: rr.RecordingStream, block: Block, start_ns: int) -> None:
        """Mark the beginning and end of bursts in the lane and, when one has ended, in the plots."""
        interrupted = (block.session, block.k0) != self._end
        if block.burst != self._burst[0] or (self._burst[0] and interrupted):
            self.end_burst(recording, start_ns)
            if block.burst:
                self.lane("burst").enter(recording, block.t0_ns, start_ns, "burst", paths.BURST)
            self._burst = (block.burst, block.t0_ns)
        self._end = (block.session, block.k0 + len(block))
        self._end_ns = block.t0_ns + round(len(block) * block.dt * 1e9)

    def follow_tuning(self, recording: rr.RecordingStream, block: Block, start_ns: int) -> None:
        """Mark in a lane where a Q acts."""
        if block.tuning != self._tuning:
            self._tuning = block.tuning
            words = "" if not block.tuning else "changes" if block.tuning.endswith(" moves") else "Q acts"
            self.lane("retuned").enter(recording, block.t0_ns, start_ns, words, paths.BURST)

    def end_burst(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """End the burst that is playing, if any, with the last sample seen."""
        name, begin_ns = self._burst
        if name:
            self.lane("burst").enter(recording, self._end_ns, start_ns, "", paths.BURST)
            for group in self.groups.values():
                group.shade(recording, begin_ns, self._end_ns, start_ns)
        self._burst = ("", 0)

    def decide(self, recording: rr.RecordingStream, finding: Finding, start_ns: int) -> None:
        """Take a decision."""
        self.answers.take(recording, finding, start_ns)
        e = finding.evidence
        key = (e.detector, e.output)
        if key not in self._tracks:
            number = sum(detector == e.detector for detector, _ in self._tracks)
            self._tracks[key] = DetectorTrack(recording, self.id, e, number)
        self._tracks[key].add(recording, finding, start_ns)

    def lane(self, name: str) -> Lane:
        """Return the lane of this name."""
        return self._lanes.setdefault(name, Lane(paths.lane(self.id, name)))

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send everything collected."""
        for group in self.groups.values():
            group.send(recording, start_ns)
        for track in self._tracks.values():
            track.send(recording, start_ns)
        self.answers.send(recording, start_ns)

    def layout(self) -> MachineLayout:
        """Return what there is to lay out, groups in their fixed order."""
        groups = {name: self.groups[name].layout for name in paths.GROUPS if name in self.groups}
        detectors = Counter(detector for detector, _ in self._tracks)
        lanes = len(self._lanes) + len(self._tracks)
        return MachineLayout(groups, detectors, lanes, self.reported, self.answers.severities, self.planes)



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
