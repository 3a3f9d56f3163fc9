"""A lane of states over time."""

from __future__ import annotations

import rerun as rr

from afdsvc.present.rerun.columns import at


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
