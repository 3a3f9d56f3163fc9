"""Any recording as traces: MCAP of afdsvc, a table with standard column names, or a foreign one with a mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.files.recording.mcap_file import METADATA
from afdsvc.files.recording.reader import Recording
from afdsvc.files.tables.foreign import PREPARED, in_model_units, read_foreign
from afdsvc.files.tables.mapping import DataMapping, read_mapping
from afdsvc.files.tables.tables import read_table

TABLES = (".csv", ".parquet", ".mat", ".npz")


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


def load_table(path: Path, naming: Naming, model: Model | None = None, dt: float | None = None, gaps: bool = False) -> list[Trace]:
    """Return a table as traces: by its own column names (one trace, ``dt`` as in `read_table`), or by the mapping file.

    ``gaps`` allows cells without a number, as NaN.
    """
    mapping = naming.for_others()
    if mapping:
        return read_foreign(path, mapping, model)
    trace = read_table(path, naming.pairs, dt, gaps)
    if naming.pairs:
        said = "\n".join(f"{new} is {old}" if new else f"{old} is left out" for old, new in naming.pairs.items())
        trace = replace(trace, notes={**trace.notes, PREPARED: said})
    return [in_model_units(trace, model) if model else trace]


def load_traces(path: Path, naming: Naming, model: Model | None = None, machine: str | None = None) -> list[Trace]:
    """Return every gapless stretch of a file; raises `BadInput` naming the file and what is wrong with it."""
    if path.suffix.lower() in TABLES:
        return load_table(path, naming, model)
    recording = Recording(path)
    if not is_ours(recording, naming):
        return read_foreign(path, foreign_mapping(recording, naming), model)
    return own_traces(recording, model, machine)


def is_ours(recording: Recording, naming: Naming) -> bool:
    """Whether a recording holds samples of ours; with a mapping, only where its writer says so too."""
    return bool(recording.machines) and (naming.mapping is None or METADATA in recording.metadata)


def own_traces(recording: Recording, model: Model | None = None, machine: str | None = None) -> list[Trace]:
    """Return the traces of one of our recordings; what was done when it was imported stays with them."""
    facts = recording.metadata.get("import", {})
    found = recording.traces(machine)
    if facts.get(PREPARED):
        said = {"path": str(recording.path), PREPARED: facts[PREPARED]}
        found = [Trace(t.name, t.dt, t.channels, t.values, t.t0, {**t.notes, **said}) for t in found]
    return [in_model_units(t, model) for t in found] if model else found


def foreign_mapping(recording: Recording, naming: Naming) -> DataMapping:
    """Return the mapping for a recording that is not ours; raises `BadInput` listing its topics without one."""
    mapping = naming.for_others() or (DataMapping().extended(naming.pairs) if naming.pairs else None)
    if mapping is None or not mapping.signals:
        held = ", ".join(recording.counts) or "no messages"
        raise BadInput(f"{recording.path}: holds no samples of afdsvc; expected a mapping of its topics (--mapping FILE.toml): it has {held}")
    return mapping
