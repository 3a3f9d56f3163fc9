"""What is shown of one machine: its groups of signals, its bursts, its detectors."""

from __future__ import annotations

from collections import Counter

import numpy as np
import rerun as rr

from afdsvc.api.signals import Block
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.answers import Answers
from afdsvc.present.rerun.blueprint import MachineLayout
from afdsvc.present.rerun.decisions import DetectorTrack
from afdsvc.present.rerun.lanes import Lane
from afdsvc.present.rerun.signals import Groups, SignalGroup
from afdsvc.wire.messages import Finding


class MachineReview:
    """Collects what belongs to one machine and sends it on request."""

    def __init__(self, id: str, quiet_hertz: float) -> None:
        self.id, self._quiet = id, quiet_hertz
        self.groups: dict[str, SignalGroup] = {}
        self.expected: dict[str, tuple[float, float]] = {}
        self._tracks: dict[tuple[str, str], DetectorTrack] = {}
        self._lanes: dict[str, Lane] = {}
        self._burst: tuple[str, int] = ("", 0)
        self._end = ("", 0)
        self._end_ns = 0
        self.told = False
        self.answers = Answers(id)
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
        return MachineLayout(groups, detectors, lanes, self.told, self.answers.severities, self.planes)
