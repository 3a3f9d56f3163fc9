"""A table as a recording: the samples to the last bit, with the model beside them when there is one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace
from afdsvc.files.model.model_file import model_text
from afdsvc.files.recording.mcap_file import Header
from afdsvc.files.recording.recorder import Recorder, RecordingSettings
from afdsvc.files.tables.tables import with_units
from afdsvc.files.unfinished import writing
from afdsvc.wire.codec import encode_block
from afdsvc.wire.keys import checked_machine

BLOCK_SECONDS = 0.05


def import_table(
    trace: Trace, path: str | Path, model: Model | None = None, machine: str = "table", start_ns: int = 0,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write a trace as a recording of one machine and return its path; raises `BadInput` when it cannot be written.

    ``start_ns`` is the Unix time of sample 0 (a table knows none: 1970 then). Units come from the model.
    """
    return import_traces([trace], path, model, machine, start_ns, overwrite)


def import_traces(
    traces: Sequence[Trace], path: str | Path, model: Model | None = None, machine: str = "table", start_ns: int = 0,
    overwrite: bool = False,
) -> Path:  # fmt: skip
    """Write the stretches of one machine between gaps as `import_table` does one; the gaps stay.

    Their times count from the first one's, in samples; what was done to the data is kept with the facts.
    """
    checked_machine(machine)
    traces = [with_units(t, model) if model else t for t in traces]
    first, samples = traces[0], sum(len(t) for t in traces)
    facts = {"source": first.name, "t0": repr(first.t0), "dt": repr(first.dt), "samples": str(samples)}
    if first.notes.get("prepared"):
        facts["prepared"] = first.notes["prepared"]
    models = {machine: model.raw or model_text(model)} if model else {}
    # One file, whatever its size: a table is one thing.
    settings = RecordingSettings(Path(path), max_bytes=1 << 62, max_seconds=float("inf"), overwrite=overwrite)
    with writing(Path(path)):
        recorder = Recorder(settings, Header(models=models))
        recorder.facts("import", facts)
        for block in _blocks(traces, machine, start_ns):
            recorder.block(encode_block(block), block)
        recorder.close()
    return recorder.path


def _blocks(traces: Sequence[Trace], machine: str, start_ns: int) -> Iterator[Block]:
    dt = traces[0].dt
    length, seq = max(1, round(BLOCK_SECONDS / dt)), 0
    for trace in traces:
        first = round((trace.t0 - traces[0].t0) / dt)
        for k in range(0, len(trace), length):
            t_ns = start_ns + round((first + k) * dt * 1e9)
            yield Block(machine, "table", seq, first + k, dt, t_ns, trace.channels, trace.values[k : k + length])
            seq += 1
