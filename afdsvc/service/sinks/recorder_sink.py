"""A sink that records all messages of one machine into MCAP files."""

from __future__ import annotations

import datetime
import time
from collections.abc import Mapping
from pathlib import Path

from afdsvc import __version__
from afdsvc.api.signals import Block, residual_block
from afdsvc.files.recording.foxglove_log import Level
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingFailed, RecordingSettings
from afdsvc.files.site import Recording
from afdsvc.lti.statespace import Array
from afdsvc.wire import codec
from afdsvc.wire.messages import AlarmChange, AlarmKind, BurstRequest, Finding, RigEvent

LEVELS = {"info": Level.INFO, "warning": Level.WARNING, "error": Level.ERROR}


def alarm_sentence(change: AlarmChange) -> str:
    """Return what happened to an alarm as one sentence."""
    by = f" by {change.who}" if change.who else ""
    why = f": {change.why}" if change.why else ""
    return f"alarm {change.alarm.id} {change.event}{by}{why}"


class RecorderSink:
    """Records one machine. The file is begun with the first message, so a machine that never speaks leaves none.

    ``site`` and ``model`` are the texts put inside; ``facts`` further lines of its header.
    """

    def __init__(
        self, settings: Recording, machine: str, site: str, model: str, start_ns: int, facts: Mapping[str, str]
    ) -> None:
        moment = datetime.datetime.fromtimestamp(start_ns / 1e9, datetime.UTC)
        self.base = _unused(settings.folder / f"{machine}-{moment:%Y%m%dT%H%M%S}")
        self._settings = RecordingSettings(
            self.base.with_suffix(".mcap"),
            round(settings.max_megabytes * 1e6),
            60 * settings.max_minutes,
            preview_hertz=settings.preview_hz,
        )
        self.header = Header(site, {machine: model}, {"software": f"afdsvc {__version__}", "machine": machine, **facts})
        self._recorder: Recorder | None = None
        self._next_try, self._why, self._unopened = float("-inf"), "", 0

    @property
    def dropped(self) -> int:
        """Messages that could not be recorded."""
        return self._unopened + (self._recorder.dropped if self._recorder else 0)

    @property
    def paths(self) -> list[Path]:
        """The files written so far."""
        return self._recorder.paths if self._recorder else []

    @property
    def bytes_written(self) -> int:
        """Bytes in all files."""
        return self._recorder.bytes_written if self._recorder else 0

    def block(self, block: Block, payload: bytes) -> None:
        """Record the bytes as they came."""
        self._open().block(payload, block)

    def residual(self, block: Block, residual: Array) -> None:
        """Record the whitened residual."""
        made = residual_block(block, residual)
        self._open().residual(codec.encode_block(made), made)

    def finding(self, finding: Finding) -> None:
        """Record a decision."""
        self._open().finding(codec.encode_finding(finding), finding)

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Record an event as it came."""
        self._open().event(payload, event)

    def request(self, request: BurstRequest) -> None:
        """Record a burst that is asked for."""
        self._open().request(codec.encode_burst_request(request), request)

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Record a sentence."""
        self._open().note(t_ns, LEVELS[level], sentence, machine)

    def alarm(self, change: AlarmChange) -> None:
        """Record what happened to an alarm as a sentence."""
        level = Level.INFO if not change.alarm.active or change.alarm.kind is AlarmKind.NOTICE else Level.WARNING
        self._open().note(change.t_ns, level, alarm_sentence(change), change.alarm.machine)

    def tick(self) -> None:
        """Flush when it is due."""
        if self._recorder:
            self._recorder.tick()

    def close(self) -> None:
        """Finish the file."""
        if self._recorder:
            self._recorder.close()

    def _open(self) -> Recorder:
        """Return the recorder; while its first file cannot be made, it is tried as rarely as any later one."""
        if self._recorder is None:
            if time.monotonic() < self._next_try:
                self._unopened += 1
                raise RecordingFailed(self._why)
            try:
                self._recorder = self._begin()
            except RecordingFailed as error:
                self._next_try, self._why = time.monotonic() + self._settings.retry_seconds, str(error)
                self._unopened += 1
                raise
        return self._recorder

    def _begin(self) -> Recorder:
        try:
            self._settings.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingFailed(f"{self._settings.path.parent}: cannot be made: {error.strerror}") from None
        return Recorder(self._settings, self.header)


def _unused(base: Path) -> Path:
    """Return a base name of which no file exists: a service may start twice in one second."""
    names = (base.with_name(f"{base.name}-{n}") if n > 1 else base for n in range(1, 10_000))
    return next(name for name in names if not name.with_suffix(".mcap").exists())
