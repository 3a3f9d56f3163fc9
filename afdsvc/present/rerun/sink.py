"""The review as a sink of the service: live, as files, or both."""

from __future__ import annotations

from pathlib import Path

from afdsvc.api.signals import Block
from afdsvc.files.recording.foxglove import Level
from afdsvc.present.rerun.log import ReviewLog
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import AlarmChange, Finding, Notice, Residual, RigEvent


class ReviewSink:
    """Logs into Rerun; begun with the first message, in the thread that brings it. Takes any number of machines.

    A file holds ``max_seconds`` of machine time; ``name.0001.rrd`` and so on follow, never in the middle of a burst. A
    live review is one for as long as it lasts, since viewers are connected to it.
    """

    def __init__(self, path: Path | None, live: int | None = None, max_seconds: float = 3600.0) -> None:
        self.paths: list[Path] = []
        self._first, self._live, self._max_ns = path, live, round(max_seconds * 1e9)
        self._log: ReviewLog | None = None
        self._begun_ns = 0

    def take(self, message: Message) -> None:
        """Show a message; a request is shown when it is played or refused."""
        match message.value:
            case Block() as block:
                self._new_file_when_due(block)
                self._open(block.t0_ns).block(block)
            case Residual(block):
                self._open(block.t0_ns).residual(block)
            case Finding() as finding:
                self._open(finding.t_ns).finding(finding)
            case RigEvent() as event:
                self._open(event.t_ns).event(event)
            case Notice(machine, level, sentence, t_ns):
                self._open(t_ns).note(t_ns, Level[level.upper()], sentence, machine)
            case AlarmChange(alarm, event, t_ns):
                self._open(t_ns).note(t_ns, Level.INFO, f"alarm {alarm.id} {event}", alarm.machine)

    def tick(self) -> None:
        """Nothing: samples are sent as their own time goes on."""

    def close(self) -> None:
        """Finish the file; harmless when called twice."""
        if self._log:
            self._log.close()
        self._log = None

    def _new_file_when_due(self, block: Block) -> None:
        full = self._log is not None and block.t0_ns - self._begun_ns >= self._max_ns
        if full and self._live is None and not block.burst:
            self.close()

    def _open(self, t_ns: int) -> ReviewLog:
        if self._log is None:
            self._begun_ns = t_ns
            path = self._next_path()
            self._log = ReviewLog(path, self._live)
            self.paths += [path] if path else []
        return self._log

    def _next_path(self) -> Path | None:
        if self._first is None or not self.paths:
            return self._first
        return self._first.with_name(f"{self._first.stem}.{len(self.paths):04d}{self._first.suffix}")
