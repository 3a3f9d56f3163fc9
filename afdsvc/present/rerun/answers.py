"""The answers in the order of the questions: is something wrong, since when, which part, how sure."""

from __future__ import annotations

import datetime
from collections import deque

import rerun as rr

from afdsvc.api.evidence import Evidence
from afdsvc.detect.isolation import NONE
from afdsvc.diagnosis.verdict import Verdict, conclude
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.columns import Columns, at
from afdsvc.wire.messages import Finding

KEPT = 400


class Answers:
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
            self._tell(recording, "## No decision yet\n\nNo detector has made a decision so far.", t_ns, start_ns)

    def take(self, recording: rr.RecordingStream, finding: Finding, start_ns: int) -> None:
        """Take a decision; a changed answer is shown again."""
        self._evidence.append(finding.evidence)
        verdict = conclude(list(self._evidence))
        if verdict.detected and self._begun_ns is None:
            self._begun_ns = finding.t_ns
        self._said = self._said or verdict.fault is not None  # an early decision, which names nothing yet, is no step back
        if verdict.fault and verdict.severity:
            s = verdict.severity
            for kind, value in (("", s.value), ("_low", s.value - 2 * s.sd), ("_high", s.value + 2 * s.sd)):
                self._line(recording, "severity", verdict.fault + kind).add_row(finding.t_ns, 100 * value)
        for fault in () if self._said and not finding.evidence.severity else self._told() | {name for name, weight in verdict.weights.items() if weight >= 0.01}:
            self._line(recording, "sure", fault).add_row(finding.t_ns, 100 * verdict.weights.get(fault, 0.0))
        self._tell(recording, words(verdict, list(self._evidence), self._begun_ns, start_ns), finding.t_ns, start_ns)

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send what was collected."""
        for columns in self._lines.values():
            columns.send(recording, start_ns)

    def _told(self) -> set[str]:
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

    def _tell(self, recording: rr.RecordingStream, told: str, t_ns: int, start_ns: int) -> None:
        if told == self._words:
            return
        self._words = told
        at(recording, t_ns, start_ns)
        recording.log(paths.path(self._machine, "answer"), rr.TextDocument(told, media_type=rr.MediaType.MARKDOWN))


def words(verdict: Verdict, evidence: list[Evidence], begun_ns: int | None, start_ns: int) -> str:
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


def _likely(verdict: Verdict) -> list[str]:
    ranked = sorted(verdict.weights, key=lambda name: -verdict.weights[name])
    return [name for name in ranked if name != NONE][:3] or ["not singled out yet"]


def _sure(verdict: Verdict) -> str:
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
