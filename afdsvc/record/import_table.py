"""A table as a recording: the samples to the last bit, with the model beside them when there is one."""

from __future__ import annotations

from pathlib import Path

from afdsvc.api.model import Model
from afdsvc.api.signals import Block, Trace
from afdsvc.record.mcap_file import Header
from afdsvc.record.model_file import model_text
from afdsvc.record.recorder import Recorder, RecordingSettings
from afdsvc.record.tables import with_units
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
    checked_machine(machine)
    trace = with_units(trace, model) if model else trace
    facts = {"source": trace.name, "t0": repr(trace.t0), "dt": repr(trace.dt), "samples": str(len(trace))}
    models = {machine: model.raw or model_text(model)} if model else {}
    # One file, whatever its size: a table is one thing.
    settings = RecordingSettings(Path(path), max_bytes=1 << 62, max_seconds=float("inf"), overwrite=overwrite)
    recorder = Recorder(settings, Header(models=models))
    recorder.facts("import", facts)
    length = max(1, round(BLOCK_SECONDS / trace.dt))
    for seq, k0 in enumerate(range(0, len(trace), length)):
        t_ns = start_ns + round(k0 * trace.dt * 1e9)
        values = trace.values[k0 : k0 + length]
        block = Block(machine, "table", seq, k0, trace.dt, t_ns, trace.channels, values)
        recorder.block(encode_block(block), block)
    recorder.close()
    return recorder.path
