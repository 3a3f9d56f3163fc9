"""The recorder: encoded messages into MCAP files that rotate, survive crashes, and report write errors."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from afdsvc.api.signals import Block, Channel
from afdsvc.errors import BadInput
from afdsvc.files.recording import foxglove, mcap_file
from afdsvc.files.recording.foxglove import DecisionLog, Level, Preview, encode_log, event_sentence, evidence_sentence
from afdsvc.files.recording.mcap_file import Header, McapFile
from afdsvc.wire.messages import BurstRequest, Finding, RetuneRequest, RigDescription, RigEvent


class RecordingFailed(BadInput):
    """Nothing can be recorded at the moment; the message names the file and why. Detection need not stop for it."""


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """Where a recording goes, when it rotates (bytes, seconds), how often it is flushed, the rate of the preview [Hz].

    The first file is ``path``; ``name.0001.mcap`` and so on follow when it rotates. After a failure a new file is tried
    every ``retry_seconds``. ``preview_hertz`` 0 writes none.
    """

    path: Path
    max_bytes: int = 1 << 30
    max_seconds: float = 3600.0
    flush_seconds: float = 0.4
    preview_hertz: float = 100.0
    retry_seconds: float = 10.0
    overwrite: bool = False


class Recorder:
    """Writes messages as they come; not thread-safe, meant for a thread of its own.

    The constructor and every writing method raise `RecordingFailed` when the disk is full or the folder cannot be
    written. The recorder stays usable: it counts what it drops and tries a new file from time to time.
    """

    def __init__(
        self, settings: RecordingSettings, header: Header | None = None, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._settings, self._header, self._monotonic = settings, header or Header(), monotonic
        self._part, self._previews, self._decisions = 0, dict[tuple[Channel, ...], Preview](), DecisionLog()
        self._descriptions: dict[str, tuple[bytes, RigDescription]] = {}
        self._tunings: dict[str, tuple[bytes, RetuneRequest]] = {}
        self._attached: dict[str, tuple[str, bytes]] = {}
        self._file: McapFile | None = None
        self._opened = self._flushed = self._failed_at = monotonic()
        self._unflushed = self._written = 0
        self.paths: list[Path] = []
        self.torn: list[Path] = []  # could not be written to their end, so they have no index yet
        self.finished_bytes = 0
        self.failure = ""
        self.dropped = 0
        try:
            self._open(settings.path)
        except OSError as error:
            raise RecordingFailed(_sentence(settings.path, error)) from None

    @property
    def path(self) -> Path:
        """The file being written, or the last one that was."""
        return self.paths[-1] if self.paths else self._settings.path

    @property
    def writing(self) -> list[Path]:
        """The file being written, if any."""
        return [self._file.path] if self._file else []

    @property
    def flushed(self) -> bool:
        """Whether everything that was written has been forced to the disk."""
        return self._unflushed == 0

    @property
    def bytes_written(self) -> int:
        """Bytes in all files of this recording."""
        return self.finished_bytes + (self._file.size if self._file else 0)

    def block(self, data: bytes, block: Block) -> None:
        """Record a block and its preview."""
        self._write(lambda file: self._block(file, data, block))

    def residual(self, data: bytes, block: Block) -> None:
        """Record a block of the whitened residual."""
        name = mcap_file.topic(block.machine, mcap_file.RESIDUAL)
        self._write(lambda file: file.wire(name, "Block", block.t0_ns, data, block.seq))

    def finding(self, data: bytes, finding: Finding) -> None:
        """Record a decision, and write it to the log when it is new."""
        self._write(lambda file: self._finding(file, data, finding))

    def event(self, data: bytes, event: RigEvent) -> None:
        """Record an event of the rig, and write it to the log."""
        self._write(lambda file: self._event(file, data, event))

    def request(self, data: bytes, request: BurstRequest) -> None:
        """Record a requested burst: its lines are needed to evaluate the response later."""
        name = mcap_file.topic(request.machine, mcap_file.REQUEST)
        self._write(lambda file: file.wire(name, "BurstRequest", request.t_ns, data))

    def retuning(self, data: bytes, request: RetuneRequest) -> None:
        """Record a Q that was asked for: what bursts do while it acts follows from it. Repeated at the head of every later file."""
        self._tunings[request.machine] = (data, request)
        self._write(lambda file: _retuning(file, data, request))

    def description(self, data: bytes, description: RigDescription) -> None:
        """Record what a rig says of itself; repeated at the head of every later file."""
        self._descriptions[description.machine] = (data, description)
        self._write(lambda file: _describe(file, data, description))

    def note(self, t_ns: int, level: Level, text: str, machine: str) -> None:
        """Tell a sentence in the machine's log."""
        self._write(lambda file: _tell(file, t_ns, level, text, machine))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a text or file; repeated in every later file."""
        self._attached[name] = (media_type, data)
        self._write(lambda file: file.attach(name, media_type, data))

    def facts(self, name: str, facts: Mapping[str, str]) -> None:
        """Add metadata to the file being written."""
        self._write(lambda file: file.facts(name, facts))

    def flush(self) -> None:
        """Flush now."""
        self._guarded(self._flush)

    def tick(self) -> None:
        """Flush when it is due; to be called at least four times a second when nothing else is."""
        if self._file and self._unflushed and self._monotonic() - self._flushed >= self._settings.flush_seconds:
            self.flush()

    def close(self) -> None:
        """Finish the file; harmless when called twice."""
        if self._file:
            self._guarded(self._finish)

    def _write(self, action: Callable[[McapFile], None]) -> None:
        """Run one write, rotating and flushing when due; raise `RecordingFailed` (and count) when it is lost."""
        if not self._file:
            self._retry()
        self._unflushed += 1
        self._rotate_when_due()
        self._written += 1
        self._guarded(action)
        self.tick()

    def _guarded(self, action: Callable[[McapFile], None]) -> None:
        if not self._file:
            raise RecordingFailed(self.failure or f"{self.path}: the recording is closed")
        try:
            action(self._file)
        except OSError as error:
            self.torn += self.writing
            self._fail(self._file.path if self._file else self._next_path(), error)

    def _fail(self, path: Path, error: OSError) -> None:
        if self._file:
            self.finished_bytes += self._file.path.stat().st_size if self._file.path.exists() else 0
            self._file.abandon()
        self._file, self._failed_at = None, self._monotonic()
        # Everything since the last flush was in the chunk that could not be written.
        self.dropped, self._unflushed = self.dropped + self._unflushed, 0
        self.failure = _sentence(path, error)
        raise RecordingFailed(self.failure)

    def _retry(self) -> None:
        """Open the next file when the time has come; raise `RecordingFailed` while there is none."""
        if not self.failure:
            raise RecordingFailed(f"{self.path}: the recording is closed")
        if self._monotonic() - self._failed_at < self._settings.retry_seconds:
            self.dropped += 1
            raise RecordingFailed(self.failure)
        path, self._unflushed = self._next_path(), 1
        try:
            self._open(path).facts("gap", {"messages": str(self.dropped), "reason": self.failure})
        except OSError as error:
            self._fail(path, error)
        self.failure, self._unflushed = "", 0

    def _open(self, path: Path) -> McapFile:
        previous = {"previous": self.path.name} if self.paths else {}
        facts = {**self._header.facts, "part": str(self._part), **previous}
        header = Header(self._header.site, self._header.models, facts)
        self._file = McapFile(path, header, self._settings.overwrite and not self.paths)
        self.paths.append(path)
        self._part += 1
        self._written = 0
        self._opened = self._flushed = self._monotonic()
        for name, (media_type, data) in self._attached.items():
            self._file.attach(name, media_type, data)
        for data, description in self._descriptions.values():
            _describe(self._file, data, description)
        for data, request in self._tunings.values():
            _retuning(self._file, data, request)
        return self._file

    def _next_path(self) -> Path:
        first = self._settings.path
        number = self._part
        while (path := first.with_name(f"{first.stem}.{number:04d}{first.suffix}")).exists():
            number += 1
        return path

    def _rotate_when_due(self) -> None:
        if not self._file:
            return
        full = self._file.size >= self._settings.max_bytes
        if full or self._monotonic() - self._opened >= self._settings.max_seconds:
            self._guarded(self._rotate)

    def _rotate(self, file: McapFile) -> None:
        self._finish(file)
        self._unflushed = 1  # the message about to be written
        self._open(self._next_path())

    def _finish(self, file: McapFile) -> None:
        if not file.there():
            return self._gone(file)
        file.finish()
        self.finished_bytes += file.path.stat().st_size
        self._file, self._unflushed = None, 0

    def _flush(self, file: McapFile) -> None:
        if not file.there():
            return self._gone(file)
        file.flush()
        self._flushed, self._unflushed = self._monotonic(), 0

    def _gone(self, file: McapFile) -> None:
        """Give up a file that was deleted or cut under the recorder: what is left of it is not relied on; the next message begins a new one."""
        self._unflushed, self.paths = self._written, [path for path in self.paths if path != file.path]
        try:
            self._fail(file.path, FileNotFoundError(errno.ENOENT, "the file was deleted, moved, replaced or cut short while it was being written"))
        finally:
            self._failed_at = float("-inf")

    def _block(self, file: McapFile, data: bytes, block: Block) -> None:
        file.wire(mcap_file.topic(block.machine, mcap_file.BLOCK), "Block", block.t0_ns, data, block.seq)
        if self._settings.preview_hertz:
            preview = self._preview(block.channels)
            name, schema = mcap_file.topic(block.machine, mcap_file.PREVIEW), (preview.schema_name, preview.schema)
            for t_ns, sample in preview.messages(block, self._settings.preview_hertz):
                file.message(name, schema, t_ns, sample, preview.metadata)

    def _preview(self, channels: tuple[Channel, ...]) -> Preview:
        if channels not in self._previews:
            self._previews[channels] = Preview(channels, len(self._previews) + 1)
        return self._previews[channels]

    def _finding(self, file: McapFile, data: bytes, finding: Finding) -> None:
        evidence = finding.evidence
        file.wire(mcap_file.topic(evidence.machine, mcap_file.FINDING), "Evidence", finding.t_ns, data)
        if self._decisions.worth_telling(evidence):
            _tell(file, finding.t_ns, *evidence_sentence(evidence), evidence.machine)

    def _event(self, file: McapFile, data: bytes, event: RigEvent) -> None:
        file.wire(mcap_file.topic(event.machine, mcap_file.EVENT), "RigEvent", event.t_ns, data)
        _tell(file, event.t_ns, *event_sentence(event), event.machine)


def _describe(file: McapFile, data: bytes, description: RigDescription) -> None:
    name = mcap_file.topic(description.machine, mcap_file.DESCRIPTION)
    file.wire(name, "RigDescription", description.t_ns, data)


def _retuning(file: McapFile, data: bytes, request: RetuneRequest) -> None:
    file.wire(mcap_file.topic(request.machine, mcap_file.RETUNING), "RetuneRequest", request.t_ns, data)


def _tell(file: McapFile, t_ns: int, level: Level, text: str, machine: str) -> None:
    schema = (foxglove.NAME, foxglove.SCHEMA)
    file.message(mcap_file.topic(machine, mcap_file.LOG), schema, t_ns, encode_log(t_ns, level, text, machine))


def _sentence(path: Path, error: OSError) -> str:
    exists = isinstance(error, FileExistsError) and path.is_file()
    why = "it exists already; recordings are not overwritten" if exists else error.strerror or str(error)
    return f"{path}: cannot be written: {why}"
