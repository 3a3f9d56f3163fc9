"""The review as a sink of the runtime: live, as a file, or both."""

from __future__ import annotations

from pathlib import Path

from afdsvc.api.signals import Block
from afdsvc.lti.statespace import Array
from afdsvc.record.foxglove_log import Level
from afdsvc.review.log import ReviewLog
from afdsvc.runtime.publishing import residual_block
from afdsvc.wire.messages import BurstRequest, Finding, RigEvent

_LEVELS = {"info": Level.INFO, "warning": Level.WARNING, "error": Level.ERROR}


class ReviewSink:
    """Logs into Rerun; begun with the first message, in the thread that brings it. Takes any number of machines."""

    def __init__(self, path: Path | None, live: int | None = None) -> None:
        self._path, self._live = path, live
        self._log: ReviewLog | None = None

    def block(self, block: Block, payload: bytes) -> None:
        """Show samples."""
        self._open().block(block)

    def residual(self, block: Block, residual: Array) -> None:
        """Show the whitened residual."""
        self._open().residual(residual_block(block, residual))

    def finding(self, finding: Finding) -> None:
        """Show a decision."""
        self._open().finding(finding)

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Tell an event."""
        self._open().event(event)

    def request(self, request: BurstRequest) -> None:
        """Nothing: what was asked for is told when it is played or refused."""

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Tell a sentence."""
        self._open().note(t_ns, _LEVELS[level], sentence, machine)

    def tick(self) -> None:
        """Nothing: samples are sent as their own time goes on."""

    def close(self) -> None:
        """Finish the file."""
        if self._log:
            self._log.close()

    def _open(self) -> ReviewLog:
        if self._log is None:
            self._log = ReviewLog(self._path, self._live)
        return self._log
