"""`afdsvc diagnose`: the pipeline of the service, run over recordings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.evidence import Evidence
from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace, of_role
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned, RecordedMachine
from afdsvc.app.pipelines import pipeline_of
from afdsvc.detect.features.innovations import decay
from afdsvc.diagnosis.verdict import conclude
from afdsvc.errors import BadInput
from afdsvc.excite.recorded_bursts import marked, recorded_bursts
from afdsvc.files.model.model_file import read_model
from afdsvc.files.open import MappedTopics, Naming, OwnRecording, TableFile, open_file
from afdsvc.files.recording.mcap_file import BLOCK, REQUEST, RETUNING
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Bursts, DetectorSection, DriverSection, MachineSection
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.tables.tables import import_traces, with_units
from afdsvc.hal.replay import blocks_of
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service.operator_requests import json_values
from afdsvc.wire.messages import BurstRequest, RetuneRequest

Through = Literal["alpha", "input", "setpoint"]
Samples = TypeVar("Samples", Trace, Block)
STILL = 100  # samples that references rest for before a burst is looked for in them
CALIBRATED = 2 / 3  # of the quiet samples before the first burst


def diagnose_recordings(
    recordings: Sequence[Path | Trace], model: Path | Model | None = None, calibrate: float | None = None, calibrate_on: Path | None = None,
    detectors: Sequence[str] = (), naming: Naming = Naming(), allow_code: bool = False,
) -> dict[str, Any]:
    """Return the document of ``diagnose --json`` for recordings (MCAP), tables and traces; raises `BadInput` naming the file.

    ``detectors`` are used instead of those the recording's own site names. ``model`` may be a simulator only with ``allow_code``; then
    its linear part is used. A simulator inside a recording never runs.
    """
    plugins, given = load(), read_model(model, allow_code) if isinstance(model, Path) else model
    found: list[dict[str, Any]] = []
    for path in recordings:
        if isinstance(path, Trace):
            assert given is not None  # noqa: S101 - the Python interface asks for one
            found += _diagnose_traces(path.name, "table", [with_units(path, given)], given, calibrate, calibrate_on, plugins, detectors)
            continue
        file = open_file(path, naming)
        if isinstance(file, OwnRecording):
            found += _diagnose_own(file, given, calibrate, plugins, detectors)
        else:
            found += _diagnose_foreign(path, file, given, calibrate, calibrate_on, plugins, detectors)
    return {"recordings": found}


def evidence_of(machine: Commissioned, blocks: Iterable[Block], bursts: Iterable[Burst], plugins: Plugins) -> OfflineDiagnosis:
    """Return everything the detectors and checks say about blocks in their order."""
    replay = OfflineDiagnosis(machine, plugins)
    for burst in bursts:
        replay.stream.announce(burst)
    for block in blocks:
        replay.take(block)
    return replay


class OfflineDiagnosis:
    """A machine's pipeline over blocks: evidence, remarks, the spans of bursts as (name, first sample, samples, dt), the session; whether a passive
    detector had quiet data to judge, even where it had nothing to say."""

    def __init__(self, machine: Commissioned, plugins: Plugins) -> None:
        self.machine, self.stream = machine, pipeline_of(machine, plugins)
        self.evidence: list[Evidence] = []
        self.remarks: list[str] = []
        self.spans: list[tuple[str, int, int, float]] = []
        self.session = ""
        self.seconds = 0.0
        self.watched = False
        self._watches = any(getattr(plugins.get("detectors", d.kind), "passive", False) for d in machine.config.detectors)

    def take(self, block: Block) -> None:
        """Judge a block."""
        outcome = self.stream.step(block)
        self.evidence += outcome.evidence
        self.remarks += [f.message for f in outcome.findings]
        ready = self.stream.ready_at
        if not block.burst and outcome.residual is not None and ready is not None and block.k0 + len(block) > ready:
            self.watched = self._watches
        self.follow(block)

    def follow(self, block: Block) -> None:
        """Extend the span of the burst that is playing."""
        self.session, self.seconds = block.session, self.seconds + len(block) * block.dt
        if not block.burst:
            return
        if self.spans and self.spans[-1][0] == block.burst:
            name, start, _, dt = self.spans[-1]
            self.spans[-1] = (name, start, block.k0 + len(block) - start, dt)
        else:
            self.spans.append((block.burst, block.k0, len(block), block.dt))


def _diagnose_own(
    file: OwnRecording, model: Model | None, calibrate: float | None, plugins: Plugins, detectors: Sequence[str]
) -> list[dict[str, Any]]:
    """Diagnose every machine of a recording of ours, in one pass over the file."""
    recording, machines = file.recording, dict[str, _RecordedMachine]()
    at_once = model is None and "site.toml" in recording.front.attachments and "import" not in recording.front.metadata
    for id, message in recording.decoded(None, BLOCK, REQUEST, RETUNING):
        if id not in machines:
            machines[id] = _RecordedMachine(id, file, at_once, model, calibrate, plugins, detectors)
        machines[id].take(message)
    if not recording.machines:
        raise BadInput(f"{recording.path}: holds no samples of any machine")
    return [machines[id].document() for id in recording.machines if machines[id].seen]


@dataclass
class _RecordedMachine:
    """A machine of a recording. Its blocks wait until the burst in them is known, and to the end unless it is known ``at_once``."""

    id: str
    file: OwnRecording
    at_once: bool
    model: Model | None
    calibrate: float | None
    plugins: Plugins
    detectors: Sequence[str]
    waiting: deque[Block] = field(default_factory=deque)
    bursts: dict[str, Burst] = field(default_factory=dict)
    tunings: dict[str, StateSpace] = field(default_factory=dict)
    replay: OfflineDiagnosis | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def seen(self) -> bool:
        """Whether there were samples."""
        return bool(self.waiting) or self.replay is not None

    def take(self, message: object) -> None:
        """Take a block or the request of a burst or a Q."""
        if isinstance(message, RetuneRequest):
            self.tunings[message.name] = message.tuning.Q
        elif isinstance(message, BurstRequest):
            self.bursts[message.burst.name] = message.burst
            if self.replay:
                self.replay.stream.announce(message.burst)
        elif isinstance(message, Block):
            self.waiting.append(message)
        while self.at_once and self.waiting and (not self.waiting[0].burst or self.waiting[0].burst in self.bursts):
            self._judge(self._begun(), self.waiting.popleft())

    def document(self) -> dict[str, Any]:
        """Judge the blocks that wait and return the machine's part of ``diagnose --json``."""
        replay, recording = self._begun(), self.file.recording
        for block in self.waiting:
            self._judge(replay, block)
        remarks = [*([recording.loss] if recording.loss else []), *replay.remarks]
        return document(str(recording.path), self.id, replay, self.bursts, replay.machine, remarks, self.notes)

    def _judge(self, replay: OfflineDiagnosis, block: Block) -> None:
        """Judge a block; detectors for the loop with a Q are designed when the first block bears its name, once."""
        Q = self.tunings.pop(block.tuning, None)
        if Q is not None:
            replay.stream.announce_tuning(block.tuning, Q)
        replay.take(block)

    def _begun(self) -> OfflineDiagnosis:
        if self.replay is None:
            blocks, recording = list(self.waiting), self.file.recording
            imported = self.file.joined(blocks) if not self.at_once and "import" in recording.metadata else []
            inside = self.model or recording.model(self.id)
            through = _entered(imported[0], inside) if imported and inside else "alpha"
            if through != "alpha":
                rest = blocks[0].values[0]
                blocks, imported = [_from_rest(b, rest) for b in blocks], [_from_rest(t, rest) for t in imported]
            machine = _watched_by(self.detectors, _machine_of(recording, self.id, blocks, self.model, self.calibrate, self.plugins, through))
            machine, played = _excited(machine, imported, self.calibrate)
            self.notes, self.waiting = prepared(imported[:1]), deque(marked(blocks, played))
            self.bursts |= {burst.name: burst for _, burst in played}
            self.replay = OfflineDiagnosis(machine, self.plugins)
            for burst in self.bursts.values():
                self.replay.stream.announce(burst)
        return self.replay


def _played(machine: Commissioned, trace: Trace) -> list[tuple[int, Burst]]:
    """Return the bursts in a trace's columns of excitation with their first samples; raises `BadInput` when a column is missing."""
    through = machine.config.bursts.through
    role = "alpha" if through == "alpha" else "ref"
    names = [f"{role}_{v.name}" for v in (machine.outputs if through == "setpoint" else machine.inputs)]
    found = [c.name for c in trace.channels if c.role == role]
    if not trace.role(role).any():
        return []
    if sorted(found) != sorted(names):
        raise BadInput(f"{trace.name}: excitation in the columns {', '.join(found)}; expected {', '.join(names)}, one for each {'output' if through == 'setpoint' else 'input'} of the model")
    loop = machine.plant if machine.controller is None else star(machine.plant, machine.controller.interconnection, *machine.plant.D.shape)
    settle = decay(loop, 1e-3) if loop.is_stable() else len(trace)
    return recorded_bursts(np.column_stack([trace.column(n) for n in names]), trace.dt, settle, settle)


def _excited(
    machine: Commissioned, traces: Sequence[Trace], calibrate: float | None
) -> tuple[Commissioned, list[tuple[int, Burst]]]:
    """Return the machine and the bursts of its traces; unless its length is given, calibration ends before the first of them, two
    thirds of the quiet samples being used."""
    offsets = [round((t.t0 - traces[0].t0) / t.dt) for t in traces]
    played = [(k + first, burst) for t, k in zip(traces, offsets, strict=True) for first, burst in _played(machine, t)]
    if not played or calibrate:
        return machine, played
    seconds = min(machine.config.calibrate_seconds, CALIBRATED * played[0][0] * machine.plant.dt)
    return replace(machine, config=machine.config.model_copy(update={"calibrate_seconds": seconds})), played


def _machine_of(
    recording: Recording, id: str, blocks: Sequence[Block], model: Model | None, calibrate: float | None, plugins: Plugins,
    through: Through = "alpha",
) -> Commissioned:
    """Return the machine as its recording describes it; a model named by the caller takes precedence over the embedded one."""
    first, watched = blocks[0], None
    inside = model or recording.model(id)
    if inside is not None:
        watched = RecordedMachine(inside, first.dt, first.channels)
    if recording.site and model is None:
        return commissioning.commission_embedded(recording.site, f"{recording.path}:site.toml", id, plugins, watched)
    if watched is None:
        raise BadInput(f"{recording.path}: carries neither site nor model; give one with --model MODEL.toml (model=)")
    samples = sum(len(b) for b in blocks)
    return commissioning.commission(_bare(id, calibrate or samples * first.dt / 2, None, through), plugins, watched)


def _diagnose_foreign(
    path: Path, file: TableFile | MappedTopics, model: Model | None, calibrate: float | None, on: Path | None, plugins: Plugins, detectors: Sequence[str]
) -> list[dict[str, Any]]:
    """Diagnose a table, or a recording of others."""
    if model is None:
        if isinstance(file, MappedTopics):
            file.mapping()  # without it, that is what is missing first
        raise BadInput(f"{path}: a table carries no model; give one with --model MODEL.toml (model=)")
    return _diagnose_traces(str(path), path.stem.replace(" ", "_"), file.traces(model), model, calibrate, on, plugins, detectors)


def _diagnose_traces(
    source: str, id: str, traces: Sequence[Trace], model: Model, calibrate: float | None, on: Path | None, plugins: Plugins, detectors: Sequence[str]
) -> list[dict[str, Any]]:
    """Diagnose every stretch without a gap by itself."""
    found = []
    for number, trace in enumerate(traces, 1):
        through = _entered(trace, model)
        trace = trace if through == "alpha" else _from_rest(trace, trace.values[0])
        config = _bare(id, calibrate or len(trace) * trace.dt / 2, on, through)
        watched = RecordedMachine(model, trace.dt, trace.channels)
        machine = _watched_by(detectors, commissioning.commission(config, plugins, watched))
        machine, played = _excited(machine, [trace], calibrate)
        bursts = {burst.name: burst for _, burst in played}
        replayed = evidence_of(machine, marked(blocks_of(trace, config.id, "table", 0), played), bursts.values(), plugins)
        name = source if len(traces) == 1 else f"{source} ({number})"
        found.append(document(name, config.id, replayed, bursts, machine, replayed.remarks, prepared([trace])))
    return found


def _watched_by(detectors: Sequence[str], machine: Commissioned) -> Commissioned:
    """Return the machine with other detectors, where any are named."""
    if not detectors:
        return machine
    chosen = [DetectorSection(kind=kind) for kind in detectors]
    return replace(machine, config=machine.config.model_copy(update={"detectors": chosen}))


def _entered(trace: Trace, model: Model) -> Through:
    """Return where the bursts of a trace enter the loop.

    They count as played through references where there is no alpha, the references rest for a while at first, and all their motion
    is sums of sines between ramps: anything else is ordinary operation. References named like the outputs are set points.
    """
    names = {c.label for c in trace.channels if c.role == "ref"}
    inputs, outputs = ({v.name for v in variables} for variables in (model.inputs, model.outputs))
    ref = _from_rest(trace, trace.values[0]).role("ref")
    if names not in (inputs, outputs) or len(inputs) != len(outputs) or model.controller is None or trace.role("alpha").any():
        return "alpha"
    if ref[:STILL].any() or not ref.any() or not all(burst.lines for _, burst in recorded_bursts(ref, trace.dt, STILL, 0)):
        return "alpha"
    return "setpoint" if names == outputs else "input"


def _from_rest(samples: Samples, rest: Array) -> Samples:
    """Return samples with the references counted from their values in ``rest``, a row of samples."""
    columns = of_role(samples.channels, "ref")
    if not columns:
        return samples
    values = samples.values.copy()
    values[:, columns] -= rest[columns]
    return replace(samples, values=values)


def _bare(id: str, calibrate: float, on: Path | None = None, through: Through = "alpha") -> MachineSection:
    """Return a machine known by its model alone, its noise learnt from its first seconds."""
    placeholder = Path("model.toml")
    driver = DriverSection(kind="replay", recording=placeholder)
    return MachineSection(id=id, model=placeholder, driver=driver, calibrate_seconds=calibrate, calibrate_on=on, bursts=Bursts(through=through))


def document(
    name: str,
    machine: str,
    replayed: OfflineDiagnosis,
    bursts: Mapping[str, Burst],
    parts: Commissioned,
    remarks: Sequence[str],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Return one recording's part of ``diagnose --json``; ``notes`` say what was done to its data."""
    verdict, tested = conclude(replayed.evidence), bool(replayed.evidence) or replayed.watched
    return {
        "recording": name,
        "machine": machine,
        "bursts": [_burst(span, bursts, replayed.evidence, parts) for span in replayed.spans],
        "passive": _passive(replayed),
        "watched_s": replayed.seconds,
        "promised_alarms": _promised(parts, replayed.seconds),
        "remarks": list(remarks),
        "notes": list(notes),
        "verdict": {
            "fault": verdict.fault,
            "severity": json_values(verdict.severity),
            "first_detected_s": verdict.first_detected_s,
            "weights": dict(verdict.weights),
            "trustworthy": verdict.trustworthy and tested,
            "reason": verdict.reason if tested else "nothing was tested: there is no burst, and no quiet data that a passive detector watched",
        },
    }


def _burst(
    span: tuple[str, int, int, float], bursts: Mapping[str, Burst], evidence: Sequence[Evidence], parts: Commissioned
) -> dict[str, Any]:
    name, start, samples, dt = span
    lines = bursts[name].lines if name in bursts else ()
    excited = parts.outputs if parts.config.bursts.through == "setpoint" else parts.inputs
    inputs = list(dict.fromkeys(excited[line.input].name for line in lines))
    return {
        "name": name,
        "start_s": start * dt,
        "seconds": samples * dt,
        "input": ", ".join(inputs),
        "frequencies_rad_s": [line.omega for line in lines],
        "decisions": [decision_document(e) for e in evidence if e.burst == name],
    }


def decision_document(e: Evidence) -> dict[str, Any]:
    """Return one decision as JSON values; an infinite threshold (nothing to decide on) is None."""
    found: dict[str, Any] = json_values(
        {
            "detector": e.detector,
            "output": e.output,
            "fault": e.fault,
            "detected": e.detected and e.trustworthy,
            "statistic": e.statistic,
            "threshold": e.threshold,
            "severity": json_values(e.severity),
            "weights": dict(e.weights),
            "seconds": e.seconds,
            "trustworthy": e.trustworthy,
            "reason": e.reason,
            "p_white": e.p_white,
            "besides": {part.removeprefix("besides."): v for part, v in e.parts.items() if part.startswith("besides.")},
        }
    )
    return found


def _promised(parts: Commissioned, seconds: float) -> dict[str, float]:
    """Return how many passive false alarms each detector may raise by chance in the time it watched."""
    return {d.kind: d.false_alarms_per_day * seconds / 86400 for d in parts.config.detectors}


def _passive(replayed: OfflineDiagnosis) -> list[dict[str, Any]]:
    """Return the decisions made outside bursts."""
    return [decision_document(e) for e in replayed.evidence if not e.burst]


def import_recording(
    table: Path, out: Path, model: Path | None, mapping: Mapping[str, str], mapping_file: Path | None = None
) -> dict[str, Any]:
    """Write a table, or a recording of others, as a recording of ours; returns what was written and what was done for it."""
    nominal, naming = read_model(model) if model else None, Naming.of(mapping_file, mapping)
    traces = open_file(table, naming).traces(nominal)
    made = import_traces(traces, out, nominal, machine=table.stem)
    first, samples = traces[0], sum(len(t) for t in traces)
    return {
        "recording": str(made), "samples": samples, "channels": [c.name for c in first.channels], "dt": first.dt,
        "pieces": len(traces), "notes": prepared(traces),
    }
