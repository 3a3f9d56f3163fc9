"""The one place that opens recordings: a table, an MCAP file of ours, or one of others by a mapping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.recording.mcap_file import METADATA
from afdsvc.files.recording.reader import Recording
from afdsvc.files.tables.foreign import (
    ULOG,
    in_model_units,
    needs_mapping,
    read_foreign_columns,
    read_foreign_topics,
    topic_places,
)
from afdsvc.files.tables.foreign_mcap import places_of
from afdsvc.files.tables.mapping import DataMapping, read_mapping
from afdsvc.files.tables.rosbag import BAGS
from afdsvc.files.tables.tables import PREPARED, own_mapping, read_table
from afdsvc.files.tables.time_base import MissingSamples

TOPICS = (ULOG, *BAGS)  # hold topics with times of their own
TABLES = (".csv", ".parquet", ".mat", ".npz", ".tdms", *TOPICS)
RECORDING, SPREADSHEETS = ".mcap", (".xlsx", ".xls", ".ods")
Span = tuple[str, int, int]


@dataclass(frozen=True, slots=True)
class Naming:
    """How foreign names become ours: a mapping file, and names by foreign name (`--map`)."""

    mapping: DataMapping | None = None
    pairs: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, file: Path | None, pairs: Mapping[str, str] | None = None) -> Naming:
        """Return the naming of a mapping file and pairs; raises `BadInput` for a file that is none."""
        return cls(read_mapping(file) if file else None, pairs or {})

    def for_others(self) -> DataMapping | None:
        """Return the mapping by which a file is read as one of others; None when none was given."""
        return self.mapping.extended(self.pairs) if self.mapping else None


@dataclass(frozen=True, slots=True)
class TableFile:
    """A table: by its own column names (one trace), or by a mapping file."""

    path: Path
    naming: Naming

    def traces(self, model: Model | None = None, machine: str | None = None, gaps: bool = False) -> list[Trace]:
        """Return the table as traces, one where it has no gap; ``gaps`` allows cells without a number, as NaN, and takes a discrete model's sample time for a missing one."""
        mapping = self.naming.for_others()
        if mapping:
            return read_foreign_columns(self.path, mapping, model)
        if self.path.suffix.lower() in TOPICS:
            raise needs_mapping(self.path, "its topics have times of their own", self.places())
        step = model.plant.dt if gaps and model and model.plant and model.plant.discrete else None
        try:
            trace = read_table(self.path, self.naming.pairs, None, gaps, step, model)
        except MissingSamples:
            return read_foreign_columns(self.path, own_mapping(self.path, self.naming.pairs, model), model)
        if self.naming.pairs:
            said = [f"{new} is {old}" if new else f"{old} is left out" for old, new in self.naming.pairs.items()]
            trace = replace(trace, notes={**trace.notes, PREPARED: "\n".join([*said, *trace.notes.get(PREPARED, "").splitlines()])})
        return [in_model_units(trace, model) if model else trace]

    def places(self) -> list[str]:
        """Return what a mapping may name where the file holds topics with times of their own; nothing for a table."""
        return topic_places(self.path)


@dataclass(frozen=True, slots=True)
class MappedTopics:
    """An MCAP file of others, whose topics a mapping names."""

    recording: Recording
    naming: Naming

    def traces(self, model: Model | None = None, machine: str | None = None, gaps: bool = False) -> list[Trace]:
        """Return the mapped topics as traces, which hold no empty cells (``gaps``); raises `BadInput` listing the topics without a mapping."""
        return read_foreign_topics(self.recording, self.mapping(), model)

    def mapping(self) -> DataMapping:
        """Return the mapping; raises `BadInput` listing the topics without one."""
        mapping = self.naming.for_others() or (DataMapping().extended(self.naming.pairs) if self.naming.pairs else None)
        if mapping is None or not mapping.signals:
            raise needs_mapping(self.recording.path, "holds no samples of afdsvc", self.places())
        return mapping

    def places(self) -> list[str]:
        """Return what a mapping may name."""
        return places_of(self.recording.path, self.recording.items())


@dataclass(frozen=True, slots=True)
class OwnRecording:
    """A recording of the service, or one that ``afdsvc import`` wrote."""

    recording: Recording

    def traces(self, model: Model | None = None, machine: str | None = None, gaps: bool = False) -> list[Trace]:
        """Return the samples in pieces without gaps, whatever ``gaps``; what was done when they were imported stays with them."""
        return self.traces_and_bursts(model, machine)[0]

    def traces_and_bursts(self, model: Model | None = None, machine: str | None = None) -> tuple[list[Trace], list[Span]]:
        """Return the traces, and session, first sample and end of every burst that was played, in one pass over the file."""
        blocks = list(self.recording.blocks(machine))
        found = self.joined(blocks, machine)
        return [in_model_units(t, model) for t in found] if model else found, _burst_spans(blocks)

    def joined(self, blocks: Sequence[Block], machine: str | None = None) -> list[Trace]:
        """Return blocks as traces, with what was done when they were imported; raises `BadInput` when there are none."""
        path, found = self.recording.path, self.recording.joined(blocks, machine)
        facts = self.recording.metadata.get("import", {})
        said = {"path": str(path), PREPARED: facts[PREPARED]} if facts.get(PREPARED) else {}
        return [replace(t, notes={**t.notes, **said}) for t in found]

    def model(self, machine: str | None = None, allow_code: bool = False) -> Model:
        """Return the model of a machine (default: the first); raises `BadInput` when the recording carries none."""
        inside = [name.removesuffix("/model.toml") for name in self.recording.description if name.endswith("/model.toml")]
        machine = machine or (inside[0] if len(inside) == 1 else next(iter(self.recording.machines), ""))
        found = self.recording.model(machine, allow_code) if machine else None
        if found is None:
            of = f" of machine {machine}" if machine else ""
            raise BadInput(f"{self.recording.path}: carries no model{of}; expected a MODEL.toml before it")
        return found


OpenFile = TableFile | MappedTopics | OwnRecording


def open_file(path: Path, naming: Naming = Naming()) -> OpenFile:
    """Open a recording; what ends in `TABLES` is a table, anything else an MCAP file.

    With names given for foreign topics, only a file whose writer says that it is ours is one of ours. Raises `BadInput` naming the
    file when it cannot be read.
    """
    if path.suffix.lower() in TABLES:
        return TableFile(path, naming)
    if path.suffix.lower() in SPREADSHEETS:
        raise BadInput(f"{path}: is a spreadsheet; expected the sheet saved as CSV")
    if path.suffix.lower() == ".toml":
        raise BadInput(f"{path}: is not a recording; expected one of {', '.join(TABLES)} or an MCAP file; a model goes before the recordings, or after --model")
    recording = Recording(path)
    if METADATA in recording.front.metadata or (naming.mapping is None and recording.machines):
        return OwnRecording(recording)
    return MappedTopics(recording, naming)


def open_model(path: Path, allow_code: bool = False, machine: str | None = None) -> tuple[Model, OwnRecording | None]:
    """Return the model in a MODEL.toml, or the one a recording carries with that recording, opened."""
    if path.suffix.lower() != RECORDING:
        return read_model(path, allow_code), None
    source = OwnRecording(Recording(path))
    return source.model(machine, allow_code), source


def _burst_spans(blocks: Sequence[Block]) -> list[Span]:
    spans: dict[tuple[str, str, str], tuple[int, int]] = {}
    for block in blocks:
        if block.burst:
            key = (block.machine, block.session, block.burst)
            a, b = spans.get(key, (block.k0, block.k0))
            spans[key] = (min(a, block.k0), max(b, block.k0 + len(block)))
    return [(session, a, b) for (_, session, _), (a, b) in spans.items()]
