"""`afdsvc diagnose`: the pipeline of the service, run over recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from afdsvc.api.bursts import Burst
from afdsvc.api.evidence import Evidence
from afdsvc.api.model import Model
from afdsvc.api.signals import Block
from afdsvc.app import commissioning
from afdsvc.app.commissioning import Commissioned, RecordedMachine
from afdsvc.app.pipelines import pipeline_of
from afdsvc.diagnosis.verdict import conclude
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.recording.reader import Recording
from afdsvc.files.site import Detector, Driver, Machine
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.tables.loading import TABLES, Naming, foreign_mapping, is_ours, load_traces, own_traces
from afdsvc.files.tables.to_recording import import_traces
from afdsvc.hal.replay import blocks_of
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service.operator_requests import plain


def diagnose_recordings(
    paths: Sequence[Path], model: Path | None = None, calibrate: float | None = None, calibrate_on: Path | None = None,
    detectors: Sequence[str] = (), naming: Naming = Naming(), allow_code: bool = False,
) -> dict[str, Any]:
    """Return the document of ``diagnose --json`` for recordings (MCAP) and tables; raises `BadInput` naming the file.

    ``detectors`` are used instead of those the recording's own site names. ``model`` may be a simulator only with ``allow_code``; then
    its linear part is used. A simulator inside a recording never runs.
    """
    plugins, given = load(), None if model is None else read_model(model, allow_code)
    found: list[dict[str, Any]] = []
    for path in paths:
        if path.suffix.lower() in TABLES or not is_ours(Recording(path), naming):
            found += _diagnose_foreign(path, given, calibrate, calibrate_on, plugins, detectors, naming)
        else:
            found += _diagnose_mcap(path, given, calibrate, plugins, detectors)
    return {"recordings": found}


def evidence_of(machine: Commissioned, blocks: Iterable[Block], bursts: Iterable[Burst], plugins: Plugins) -> Replayed:
    """Return everything the detectors and checks say about blocks in their order."""
    stream = pipeline_of(machine, plugins)
    for burst in bursts:
        stream.announce(burst)
    replayed = Replayed()
    for block in blocks:
        outcome = stream.step(block)
        replayed.evidence += outcome.evidence
        replayed.remarks += [f.message for f in outcome.findings]
        replayed.follow(block)
    return replayed


class Replayed:
    """What came of a replay: evidence, remarks, the spans of bursts as (name, first sample, samples, dt), the session."""

    def __init__(self) -> None:
        self.evidence: list[Evidence] = []
        self.remarks: list[str] = []
        self.spans: list[tuple[str, int, int, float]] = []
        self.session = ""
        self.seconds = 0.0

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


def _diagnose_mcap(
    path: Path, model: Model | None, calibrate: float | None, plugins: Plugins, detectors: Sequence[str]
) -> list[dict[str, Any]]:
    recording = Recording(path)
    if not recording.machines:
        raise BadInput(f"{path}: holds no samples of any machine")
    found = []
    for id in recording.machines:
        machine = _watched_by(detectors, _machine_of(recording, id, model, calibrate, plugins))
        bursts = [r.burst for r in recording.requests(id)]
        replayed = evidence_of(machine, recording.blocks(id), bursts, plugins)
        remarks = [*([recording.loss] if recording.loss else []), *replayed.remarks]
        imported = prepared(own_traces(recording, None, id)[:1]) if "import" in recording.metadata else []
        found.append(document(str(path), id, replayed, {b.name: b for b in bursts}, machine, remarks, imported))
    return found


def _machine_of(recording: Recording, id: str, model: Model | None, calibrate: float | None, plugins: Plugins) -> Commissioned:
    """Return the machine as its recording describes it; a model named by the caller takes precedence over the embedded one."""
    first = next(recording.blocks(id))
    watched = None
    inside = model or recording.model(id)
    if inside is not None:
        watched = RecordedMachine(inside, first.dt, first.channels)
    if recording.site and model is None:
        return commissioning.commission_embedded(recording.site, f"{recording.path}:site.toml", id, plugins, watched)
    if watched is None:
        raise BadInput(f"{recording.path}: carries neither site nor model; give one with --model MODEL.toml")
    samples = sum(len(b) for b in recording.blocks(id))
    return commissioning.commission(_bare(id, calibrate or samples * first.dt / 2), plugins, watched)


def _diagnose_foreign(
    path: Path, model: Model | None, calibrate: float | None, on: Path | None, plugins: Plugins, detectors: Sequence[str], naming: Naming
) -> list[dict[str, Any]]:
    """Diagnose a table, or a recording of others: every stretch without a gap by itself."""
    nominal = _wanted_model(path, model, naming)
    traces = load_traces(path, naming, nominal)
    found = []
    for number, trace in enumerate(traces, 1):
        config = _bare(path.stem.replace(" ", "_"), calibrate or len(trace) * trace.dt / 2, on)
        watched = RecordedMachine(nominal, trace.dt, trace.channels)
        machine = _watched_by(detectors, commissioning.commission(config, plugins, watched))
        replayed = evidence_of(machine, blocks_of(trace, config.id, "table", 0), [], plugins)
        name = str(path) if len(traces) == 1 else f"{path} ({number})"
        found.append(document(name, config.id, replayed, {}, machine, replayed.remarks, prepared([trace])))
    return found


def _wanted_model(path: Path, model: Model | None, naming: Naming) -> Model:
    if model is not None:
        return model
    if path.suffix.lower() not in TABLES:
        foreign_mapping(Recording(path), naming)  # without it, that is what is missing first
    raise BadInput(f"{path}: a table carries no model; give one with --model MODEL.toml")


def _watched_by(detectors: Sequence[str], machine: Commissioned) -> Commissioned:
    """Return the machine with other detectors, where any are named."""
    if not detectors:
        return machine
    chosen = [Detector(kind=kind) for kind in detectors]
    return replace(machine, config=machine.config.model_copy(update={"detectors": chosen}))


def _bare(id: str, calibrate: float, on: Path | None = None) -> Machine:
    """Return a machine known by its model alone, its noise learnt from its first seconds."""
    placeholder = Path("model.toml")
    driver = Driver(kind="replay", recording=placeholder)
    return Machine(id=id, model=placeholder, driver=driver, calibrate_seconds=calibrate, calibrate_on=on)


def document(
    name: str,
    machine: str,
    replayed: Replayed,
    bursts: Mapping[str, Burst],
    parts: Commissioned,
    remarks: Sequence[str],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Return one recording's part of ``diagnose --json``; ``notes`` say what was done to its data."""
    verdict = conclude(replayed.evidence)
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
            "severity": plain(verdict.severity),
            "first_detected_s": verdict.first_detected_s,
            "weights": dict(verdict.weights),
            "trustworthy": verdict.trustworthy,
            "reason": verdict.reason,
        },
    }


def _burst(
    span: tuple[str, int, int, float], bursts: Mapping[str, Burst], evidence: Sequence[Evidence], parts: Commissioned
) -> dict[str, Any]:
    name, start, samples, dt = span
    lines = bursts[name].lines if name in bursts else ()
    inputs = list(dict.fromkeys(parts.inputs[line.input].name for line in lines))
    return {
        "name": name,
        "start_s": start * dt,
        "seconds": samples * dt,
        "input": ", ".join(inputs),
        "frequencies_rad_s": [line.omega for line in lines],
        "decisions": [decision(e) for e in evidence if e.burst == name],
    }


def decision(e: Evidence) -> dict[str, Any]:
    """Return one decision as JSON values; an infinite threshold (nothing to decide on) is None."""
    found: dict[str, Any] = plain(
        {
            "detector": e.detector,
            "output": e.output,
            "fault": e.fault,
            "detected": e.detected and e.trustworthy,
            "statistic": e.statistic,
            "threshold": e.threshold,
            "severity": plain(e.severity),
            "weights": dict(e.weights),
            "seconds": e.seconds,
            "trustworthy": e.trustworthy,
            "reason": e.reason,
            "p_white": e.p_white,
        }
    )
    return found


def _promised(parts: Commissioned, seconds: float) -> dict[str, float]:
    """Return how many passive false alarms each detector may raise by chance in the time it watched."""
    return {d.kind: d.false_alarms_per_day * seconds / 86400 for d in parts.config.detectors}


def _passive(replayed: Replayed) -> list[dict[str, Any]]:
    """Return the decisions made outside bursts."""
    return [decision(e) for e in replayed.evidence if not e.burst]


def import_recording(
    table: Path, out: Path, model: Path | None, mapping: Mapping[str, str], mapping_file: Path | None = None
) -> dict[str, Any]:
    """Write a table, or a recording of others, as a recording of ours; returns what was written and what was done for it."""
    nominal, naming = read_model(model) if model else None, Naming.of(mapping_file, mapping)
    traces = load_traces(table, naming, nominal)
    made = import_traces(traces, out, nominal, machine=table.stem)
    first, samples = traces[0], sum(len(t) for t in traces)
    return {
        "recording": str(made), "samples": samples, "channels": [c.name for c in first.channels], "dt": first.dt,
        "pieces": len(traces), "notes": prepared(traces),
    }
