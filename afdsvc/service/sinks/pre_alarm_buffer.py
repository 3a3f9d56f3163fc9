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
from afdsvc.lti.statespace import Array
from afdsvc.wire import codec
from afdsvc.wire.messages import AlarmChange, AlarmKind, BurstRequest, Finding, RetuneRequest, RigEvent

LEVELS = {"info": Level.INFO, "warning": Level.WARNING, "error": Level.ERROR}
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
        self._requests: deque[BurstRequest] = deque(maxlen=64)
        self._retuning: RetuneRequest | None = None
        self._bytes = 0
        self.paths: list[Path] = []

    def block(self, block: Block, payload: bytes) -> None:
        """Keep a block."""
        self._keep(block.t0_ns, len(payload), lambda recorder: recorder.block(payload, codec.decode_block(payload)))

    def residual(self, block: Block, residual: Array) -> None:
        """Nothing: it can be made again from the samples."""

    def finding(self, finding: Finding) -> None:
        """Keep a decision."""
        data = codec.encode(finding)
        self._keep(finding.t_ns, len(data), lambda recorder: recorder.finding(data, finding))

    def event(self, event: RigEvent, payload: bytes) -> None:
        """Keep an event."""
        self._keep(event.t_ns, len(payload), lambda recorder: recorder.event(payload, event))

    def request(self, request: BurstRequest | RetuneRequest) -> None:
        """Keep a burst or a Q that was asked for."""
        if isinstance(request, BurstRequest):
            self._requests.append(request)
        else:
            self._retuning = request

    def notice(self, machine: str, level: str, sentence: str, t_ns: int) -> None:
        """Keep a sentence."""
        self._keep(t_ns, len(sentence), lambda recorder: recorder.note(t_ns, LEVELS[level], sentence, machine))

    def alarm(self, change: AlarmChange) -> None:
        """Write what is kept when an alarm is raised."""
        if change.event == "raised" and change.alarm.kind is not AlarmKind.NOTICE and not change.alarm.cause:
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
        if self._retuning:
            recorder.retuning(codec.encode(self._retuning), self._retuning)
        for request in self._requests:
            recorder.request(codec.encode(request), request)
        for said in self._said:
            said.write(recorder)
        recorder.note(change.t_ns, Level.ERROR, f"alarm {change.alarm.id} raised: {change.why}", change.alarm.machine)
        recorder.close()
        self.paths.append(path)
