"""What is shown of one machine: its groups of signals, its bursts, its detectors."""

from __future__ import annotations

import numpy as np
import rerun as rr

from afdsvc.api.signals import Block
from afdsvc.review import paths
from afdsvc.review.blueprint import MachineLayout
from afdsvc.review.decisions import DetectorTrack
from afdsvc.review.lanes import Lane
from afdsvc.review.signals import Groups, SignalGroup
from afdsvc.wire.messages import Finding


class MachineReview:
    """Collects what belongs to one machine and sends it when told to."""

    def __init__(self, id: str, quiet_hertz: float) -> None:
        self.id, self._quiet = id, quiet_hertz
        self.groups: dict[str, SignalGroup] = {}
        self.expected: dict[str, tuple[float, float]] = {}
        self._tracks: dict[tuple[str, str], DetectorTrack] = {}
        self._lanes: dict[str, Lane] = {}
        self._burst: tuple[str, int] = ("", 0)
        self._end_ns = 0

    def show(self, recording: rr.RecordingStream, block: Block, groups: Groups, start_ns: int) -> bool:
        """Take samples by group and role; return whether there is something new to lay out."""
        changed = False
        for name, channels in groups.items():
            if name not in self.groups:
                self.groups[name] = SignalGroup(self.id, name, self._quiet)
                self.groups[name].extremes = self.expected.get(name, (np.inf, -np.inf))
            group = self.groups[name]
            if group.channels != channels:
                group.send(recording, start_ns)
                group.style(recording, channels)
                changed = True
            group.add(block)
        return changed

    def follow_burst(self, recording: rr.RecordingStream, block: Block, start_ns: int) -> None:
        """Mark the beginning and end of bursts in the lane and, when one has ended, in the plots."""
        name, begin_ns = self._burst
        if block.burst != name:
            self.lane("burst").enter(recording, block.t0_ns, start_ns, block.burst, paths.BURST)
            if name:
                for group in self.groups.values():
                    group.shade(recording, begin_ns, self._end_ns, start_ns)
            self._burst = (block.burst, block.t0_ns)
        self._end_ns = block.t0_ns + round(len(block) * block.dt * 1e9)

    def decide(self, recording: rr.RecordingStream, finding: Finding, start_ns: int) -> bool:
        """Take a decision; return whether its detector is new."""
        e = finding.evidence
        key, new = (e.detector, e.output), False
        if key not in self._tracks:
            number = sum(detector == e.detector for detector, _ in self._tracks)
            self._tracks[key], new = DetectorTrack(recording, e, number), True
        self._tracks[key].add(recording, finding, start_ns)
        return new

    def lane(self, name: str) -> Lane:
        """Return the lane of this name."""
        return self._lanes.setdefault(name, Lane(paths.path(self.id, "states", name)))

    def send(self, recording: rr.RecordingStream, start_ns: int) -> None:
        """Send everything collected."""
        for group in self.groups.values():
            group.send(recording, start_ns)
        for track in self._tracks.values():
            track.send(recording, start_ns)

    def layout(self) -> MachineLayout:
        """Return what there is to lay out, groups in their fixed order."""
        groups = {name: self.groups[name].unit for name in paths.GROUPS if name in self.groups}
        return MachineLayout(groups, list(dict.fromkeys(detector for detector, _ in self._tracks)))
