"""Everything about machines into Rerun, live and as a file: plain methods, collected into few calls."""

from __future__ import annotations

import socket
import uuid
from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from afdsvc.api.signals import Block
from afdsvc.errors import BadInput
from afdsvc.files.recording.foxglove import DecisionLog, Level, event_sentence, evidence_sentence
from afdsvc.present.rerun import paths
from afdsvc.present.rerun.blueprint import MachineLayout, blueprint
from afdsvc.present.rerun.machine import MachineReview
from afdsvc.present.rerun.paths import at
from afdsvc.present.rerun.plane import Plane, half_width, log_planes
from afdsvc.present.rerun.signals import Groups, as_residual, by_group
from afdsvc.wire.codec import Message
from afdsvc.wire.messages import AlarmChange, EventKind, Finding, Notice, Residual, RigEvent

LOOPBACK = "127.0.0.1"
QUIET_HERTZ = 200.0  # points per second and signal where nothing is played
_LEVELS = {Level.DEBUG: "DEBUG", Level.INFO: "INFO", Level.WARNING: "WARN", Level.ERROR: "ERROR"}


class ReviewLog:
    """Logs what machines say and what is found, into a file, to viewers on this computer, or both. Not thread-safe.

    ``live`` is a port on loopback viewers connect to (``rerun+http://127.0.0.1:PORT/proxy``). Samples are sent every
    ``batch_seconds`` of machine time. Between bursts signals are thinned to ``quiet_hertz`` points per second that keep
    every extreme (0: never); during bursts every sample is there. ``tell`` puts events and news of detectors into the
    event log (off where the messages themselves are logged). Raises `BadInput` when the file cannot be written.
    """

    def __init__(
        self, file: Path | None = None, live: int | None = None, batch_seconds: float = 0.5,
        quiet_hertz: float = QUIET_HERTZ, tell: bool = True,
    ) -> None:  # fmt: skip
        self._batch_ns, self._quiet, self._tell = round(batch_seconds * 1e9), quiet_hertz, tell
        self._machines: dict[str, MachineReview] = {}
        self._start_ns: int | None = None
        self._sent_ns = 0
        self._label, self._compared = "", False
        self._layouts: dict[str, MachineLayout] = {}
        self._decisions = DecisionLog()
        self._recording = rr.RecordingStream(paths.APPLICATION, recording_id=str(uuid.uuid4()))
        _connect(self._recording, file, live)
        self._recording.send_recording_name(file.stem if file else "live")
        _warm_up()

    def block(self, block: Block) -> None:
        """Take samples."""
        self._signals(block, by_group(block.channels))
        machine = self._machine(block.machine)
        machine.answers.say_nothing_yet(self._recording, block.t0_ns, self._start(block.t0_ns))
        machine.follow_burst(self._recording, block, self._start(block.t0_ns))
        machine.follow_tuning(self._recording, block, self._start(block.t0_ns))
        self._send_when_due(block.t0_ns)

    def residual(self, block: Block) -> None:
        """Take the whitened residual, a block with one channel per output."""
        plain = as_residual(block)
        self._signals(plain, {"whitened": {"r": plain.channels}})

    def finding(self, finding: Finding) -> None:
        """Take a decision."""
        start, e = self._start(finding.t_ns), finding.evidence
        self._machine(e.machine).decide(self._recording, finding, start)
        if self._tell and self._decisions.worth_telling(e):
            self.note(finding.t_ns, *evidence_sentence(e), e.machine)

    def event(self, event: RigEvent) -> None:
        """Take an event of a rig."""
        if self._tell:
            self.note(event.t_ns, *event_sentence(event), event.machine)
        if event.kind is EventKind.FAULT_INJECTED:
            lane = self._machine(event.machine).lane("simulated_fault")
            lane.enter(self._recording, event.t_ns, self._start(event.t_ns), event.cause or "set in", paths.BURST)

    def note(self, t_ns: int, level: Level, text: str, machine: str) -> None:
        """Take a sentence for the event log."""
        start = self._start(t_ns)
        self._machine(machine).reported = True
        at(self._recording, t_ns, start)
        self._recording.log(paths.path(self._machine(machine).id, "log"), rr.TextLog(text, level=_LEVELS[level]))

    def flush(self) -> None:
        """Send everything collected."""
        for machine in self._machines.values():
            machine.send(self._recording, self._start_ns or 0)
        layouts = {id: machine.layout() for id, machine in self._machines.items()}
        if layouts != self._layouts:
            self._recording.send_blueprint(blueprint(layouts, self._compared))
            self._layouts = layouts

    def close(self) -> None:
        """Send the rest and finish; harmless when called twice."""
        for machine in self._machines.values():
            machine.end_burst(self._recording, self._start_ns or 0)
        self.flush()
        self._recording.flush()
        self._recording.disconnect()

    def span(self, machine: str, extremes: dict[str, tuple[float, float]]) -> None:
        """Say beforehand what the views of a machine will span, so that all bursts are shaded to one height."""
        self._machine(machine).expected = extremes

    def begin(self, label: str) -> None:
        """Say that what follows is another recording, to stand beside the others from its own beginning; name it."""
        for machine in self._machines.values():
            machine.end_burst(self._recording, self._start_ns or 0)
        self.flush()
        self._label, self._start_ns, self._compared = label, None, True
        self._decisions = DecisionLog()

    def planes(self, machine: str, planes: Sequence[Plane]) -> None:
        """Show what bursts answered in the complex plane, beside where faults would have put it."""
        if planes and self._start_ns is not None:
            found = self._machine(machine)
            found.planes = tuple((plane.title, half_width(plane)) for plane in planes)
            log_planes(self._recording, found.id, planes, self._start_ns)

    def _signals(self, block: Block, groups: Groups) -> None:
        start = self._start(block.t0_ns)
        self._machine(block.machine).show(self._recording, block, groups, start)

    def _machine(self, id: str) -> MachineReview:
        name = f"{self._label}.{id}" if self._label else id
        if name not in self._machines:
            self._machines[name] = MachineReview(name, self._quiet)
        return self._machines[name]

    def _start(self, t_ns: int) -> int:
        if self._start_ns is None:
            self._start_ns = self._sent_ns = t_ns
        return self._start_ns

    def _send_when_due(self, t_ns: int) -> None:
        # A clock set back must not silence the review: any distance counts.
        if abs(t_ns - self._sent_ns) >= self._batch_ns:
            self._sent_ns = t_ns
            self.flush()


def _warm_up() -> None:
    """Do what the first logging call would do (it takes up to a second), on a recording that is thrown away."""
    aside = rr.RecordingStream(f"{paths.APPLICATION} warm-up")
    memory = aside.memory_recording()
    aside.send_columns("/x", indexes=[rr.TimeColumn("t", sequence=[0])], columns=rr.Scalars.columns(scalars=[0.0]))
    memory.drain_as_bytes()
    aside.disconnect()


def _connect(recording: rr.RecordingStream, file: Path | None, live: int | None) -> None:
    sinks: list[rr.FileSink | rr.GrpcServerSink] = []
    try:
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("wb").close()  # the viewer's own error comes too late, and from another thread
            sinks.append(rr.FileSink(file))
        if live is not None:
            _refuse_taken(live)
            sinks.append(rr.GrpcServerSink(LOOPBACK, live))
        recording.set_sinks(*sinks)
    except OSError as error:
        raise BadInput(f"{file}: cannot be written: {error.strerror or error}") from None


def _refuse_taken(port: int) -> None:
    """Raise `BadInput` when somebody listens at the port already; the viewer's server would only print it."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise BadInput(f"live review on port {port} of {LOOPBACK}: {error}; expected a free port") from None



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
