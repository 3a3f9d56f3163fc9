"""The minute before an alarm in a file of its own, from a ring buffer of all messages of a machine."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from afdsvc.api.signals import Block
from afdsvc.files.recording.foxglove import Level
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.service.sinks.recorder_sink import record
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import AlarmChange, AlarmKind, BurstRequest, Finding, Notice, RetuneRequest, RigEvent

Write = Callable[[Recorder], None]


@dataclass(frozen=True, slots=True)
class _Said:
    t_ns: int
    size: int
    write: Write


class PreAlarmBuffer:
    """A sink that keeps the last ``seconds`` of one machine in memory, at most ``most_bytes``, and writes them on an alarm.

    Every alarm that is raised and follows from no other gets one file beside ``base``; what is in it is a recording like any
    other. Bursts of the time before are kept apart, since a decision may rest on one that began before the buffer does.
    """

    def __init__(self, base: Path, header: Header, seconds: float = 60.0, most_bytes: int = 100_000_000) -> None:
        self._base, self._header, self._span, self._most = base, header, round(seconds * 1e9), most_bytes
        self._said: deque[_Said] = deque()
        self._requests: deque[Message] = deque(maxlen=64)
        self._retuning: Message | None = None
        self._bytes = 0
        self.paths: list[Path] = []

    def take(self, message: Message) -> None:
        """Keep a message, or write what is kept when an alarm is raised; residuals can be made again from the samples."""
        match message.value:
            case Block() as block:
                payload = message.payload  # the samples are not kept twice
                self._keep(block.t0_ns, len(payload), lambda recorder: recorder.block(payload, codec.decode_block(payload)))
            case Finding() | RigEvent() as value:
                self._keep(value.t_ns, len(message.payload), lambda recorder: record(recorder, message))
            case Notice() as notice:
                self._keep(notice.t_ns, len(notice.sentence), lambda recorder: record(recorder, message))
            case BurstRequest():
                self._requests.append(message)
            case RetuneRequest():
                self._retuning = message
            case AlarmChange(alarm, "raised") as change if alarm.kind is not AlarmKind.NOTICE and not alarm.cause:
                self._write(change)

    def tick(self) -> None:
        """Nothing: files are written whole."""

    def close(self) -> None:
        """Nothing: no file is open."""

    def _keep(self, t_ns: int, size: int, write: Write) -> None:
        self._said.append(_Said(t_ns, size, write))
        self._bytes += size
        while self._said and (self._bytes > self._most or t_ns - self._said[0].t_ns > self._span):
            self._bytes -= self._said.popleft().size

    def _write(self, change: AlarmChange) -> None:
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", change.alarm.fault)
        path = self._base.with_name(f"{self._base.name}-alarm-{len(self.paths) + 1:03d}-{name}.mcap")
        path.parent.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(RecordingSettings(path), self._header)
        for asked in (*filter(None, [self._retuning]), *self._requests):
            record(recorder, asked)
        for said in self._said:
            said.write(recorder)
        recorder.note(change.t_ns, Level.ERROR, f"alarm {change.alarm.id} raised: {change.why}", change.alarm.machine)
        recorder.close()
        self.paths.append(path)
