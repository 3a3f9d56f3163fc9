"""Recordings of the service: every message as it came, what came late, and the minute before each alarm."""

from __future__ import annotations

import datetime
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from afdsvc import __version__
from afdsvc.api.intervals import Intervals
from afdsvc.api.signals import Block
from afdsvc.files.recording.foxglove import Level
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingFailed, RecordingSettings
from afdsvc.files.site import RecordingSection
from afdsvc.service.sinks import FanOut
from afdsvc.wire import codec
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import (
    AlarmChange,
    AlarmKind,
    BurstRequest,
    Finding,
    Notice,
    Receipt,
    Residual,
    RetuneRequest,
    RigEvent,
)

SESSIONS, PIECES = 16, 100  # that a receipt names
LATE_SECONDS = 30.0  # without a block end a recording of blocks that were delivered later


def alarm_sentence(change: AlarmChange) -> str:
    """Return what happened to an alarm as one sentence."""
    by = f" by {change.who}" if change.who else ""
    why = f": {change.why}" if change.why else ""
    return f"alarm {change.alarm.id} {change.event}{by}{why}"


def record(recorder: Recorder, message: Message) -> None:
    """Write a message into a recording; a notice and what happened to an alarm are sentences of the machine's log."""
    match message.value:
        case Block() as block:
            recorder.block(message.payload, block)
        case Residual(block):
            recorder.residual(message.payload, block)
        case Finding() as finding:
            recorder.finding(message.payload, finding)
        case RigEvent() as event:
            recorder.event(message.payload, event)
        case BurstRequest() as request:
            recorder.request(message.payload, request)
        case RetuneRequest() as request:
            recorder.retuning(message.payload, request)
        case Notice(machine, level, sentence, t_ns):
            recorder.note(t_ns, Level[level.upper()], sentence, machine)
        case AlarmChange() as change:
            low = not change.alarm.active or change.alarm.kind is AlarmKind.NOTICE
            recorder.note(change.t_ns, Level.INFO if low else Level.WARNING, alarm_sentence(change), change.alarm.machine)


class Receipts:
    """Which samples of a machine are on the disk, by session: what its rig need not keep any more. Any thread may call."""

    def __init__(self) -> None:
        self._sessions: dict[str, Intervals] = {}
        self._lock = threading.Lock()

    def add(self, session: str, start: int, end: int) -> None:
        """Note samples from ``start`` up to, and without, ``end``; of more than `SESSIONS` the oldest is forgotten."""
        with self._lock:
            self._sessions.setdefault(session, Intervals()).add(start, end)
            if len(self._sessions) > SESSIONS:
                del self._sessions[next(iter(self._sessions))]

    def covers(self, session: str, start: int, end: int) -> bool:
        """Whether all these samples are on the disk."""
        with self._lock:
            return session in self._sessions and self._sessions[session].covers(start, end)

    def receipt(self, machine: str) -> Receipt:
        """Return the message to the rig; of very many pieces the newest."""
        with self._lock:
            return Receipt(machine, tuple((s, *pair) for s, found in self._sessions.items() for pair in found.pairs()[-PIECES:]))


class RecorderSink:
    """Records one machine. The file is begun with the first message, so a machine that never speaks leaves none.

    ``site`` and ``model`` are the texts put inside; ``facts`` further lines of its header. ``receipts`` learns what is on the disk.
    """

    def __init__(
        self, settings: RecordingSection, machine: str, site: str, model: str, start_ns: int, facts: Mapping[str, str],
        receipts: Receipts | None = None,
    ) -> None:  # fmt: skip
        self._receipts, self._unkept = receipts or Receipts(), list[tuple[str, int, int]]()
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
    def writing(self) -> list[Path]:
        """The file being written, if any."""
        return self._recorder.writing if self._recorder else []

    @property
    def torn(self) -> list[Path]:
        """Files that could not be written to their end."""
        return self._recorder.torn if self._recorder else []

    @property
    def bytes_written(self) -> int:
        """Bytes in all files."""
        return self._recorder.bytes_written if self._recorder else 0

    def take(self, message: Message) -> None:
        """Record a message, bytes that came over the wire as they came."""
        if isinstance(block := message.value, Block):
            self._unkept.append((block.session, block.k0, block.k0 + len(block)))
        with self._noting():
            record(self._open(), message)

    def tick(self) -> None:
        """Flush when it is due."""
        if self._recorder:
            with self._noting():
                self._recorder.tick()

    def close(self) -> None:
        """Finish the file."""
        if self._recorder:
            self._recorder.close()

    @contextmanager
    def _noting(self) -> Iterator[None]:
        """Note the samples that are on the disk after what is done here; a failure, at any write, loses all that are not on it yet."""
        try:
            yield
        except RecordingFailed:
            self._unkept.clear()
            raise
        if self._recorder and self._recorder.flushed and not self._recorder.failure:
            for samples in self._unkept:
                self._receipts.add(*samples)
            self._unkept.clear()

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


class LateRecorder(FanOut):
    """Records blocks that a rig kept during an outage and delivered later, as a recording of that time.

    They stay apart from the recording of what was judged live, whose order is the order of the judgement.
    """

    def __init__(
        self, settings: RecordingSection, machine: str, site: str, model: str, facts: Mapping[str, str], receipts: Receipts
    ) -> None:  # fmt: skip
        super().__init__([])
        self._arguments, self._facts, self._receipts = (settings, machine, site, model), {**facts, "delivered": "later"}, receipts
        self._sink: RecorderSink | None = None
        self._last = 0.0
        self.torn: list[Path] = []  # by files that are finished

    @property
    def writing(self) -> list[Path]:
        """The file being written, if any."""
        return self._sink.writing if self._sink else []

    def take(self, message: Message) -> None:
        """Record a block."""
        self._sink = self._sink or RecorderSink(*self._arguments, message.value.t0_ns, self._facts, self._receipts)
        self._last = time.monotonic()
        self._sink.take(message)

    def tick(self) -> None:
        """Flush when it is due; finish a file to which nothing comes any more."""
        if self._sink:
            self._sink.tick()
            if time.monotonic() - self._last > LATE_SECONDS:
                self.close()

    def close(self) -> None:
        """Finish the file."""
        sink, self._sink = self._sink, None
        if sink:
            try:
                sink.close()
            finally:
                self.torn += sink.torn


def _unused(base: Path) -> Path:
    """Return a base name of which no file exists: a service may start twice in one second."""
    names = (base.with_name(f"{base.name}-{n}") if n > 1 else base for n in range(1, 10_000))
    return next(name for name in names if not name.with_suffix(".mcap").exists())


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
        self._bytes = self._now = 0
        self.paths: list[Path] = []
        self.torn: list[Path] = []

    def take(self, message: Message) -> None:
        """Keep a message, or write what is kept when an alarm is raised; residuals can be made again from the samples."""
        match message.value:
            case Block() as block:
                payload = message.payload  # the samples are not kept twice
                self._now = block.t0_ns
                self._keep(len(payload), lambda recorder: recorder.block(payload, codec.decode_block(payload)))
            case Finding() | RigEvent():
                self._keep(len(message.payload), lambda recorder: record(recorder, message))
            case Notice() as notice:
                self._keep(len(notice.sentence), lambda recorder: record(recorder, message))
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

    def _keep(self, size: int, write: Write) -> None:
        """Keep what came when the clock of the rig read ``_now``; after a step of that clock, back or ahead, what was before it goes."""
        self._said.append(_Said(self._now, size, write))
        self._bytes += size
        while self._said and (self._bytes > self._most or abs(self._now - self._said[0].t_ns) > self._span):
            self._bytes -= self._said.popleft().size

    def _write(self, change: AlarmChange) -> None:
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", change.alarm.fault)
        path = self._base.with_name(f"{self._base.name}-alarm-{len(self.paths) + 1:03d}-{name}.mcap")
        path.parent.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(RecordingSettings(path), self._header)
        self.paths.append(path)
        try:
            for asked in (*filter(None, [self._retuning]), *self._requests):
                record(recorder, asked)
            for said in self._said:
                said.write(recorder)
            recorder.note(change.t_ns, Level.ERROR, f"alarm {change.alarm.id} raised: {change.why}", change.alarm.machine)
            recorder.close()
        finally:
            self.torn += recorder.torn
