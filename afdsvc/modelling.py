"""A modeller's files: recordings in, a better MODEL.toml and a page out. Reading, handing over, writing; nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.procedure import identify
from afdsvc.offline import TABLES
from afdsvc.record.model_file import read_model, write_model
from afdsvc.record.reader import Recording
from afdsvc.record.tables import read_table, with_units
from afdsvc.report.identify_page import identify_page


def read_traces(paths: Sequence[Path], machine: str | None = None) -> list[Trace]:
    """Return the traces of recordings (MCAP: every gapless piece) and tables; raises `BadInput` naming the file."""
    traces: list[Trace] = []
    for path in paths:
        traces += [read_table(path)] if path.suffix.lower() in TABLES else Recording(path).traces(machine)
    return traces


def identify_files(
    model: Path, recordings: Sequence[Path], holdout: Sequence[Path], out: Path | None, options: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """Identify from files; writes the improved model and an HTML page beside it and returns ``identify --json``."""
    nominal = read_model(model)
    chosen = IdentifyOptions.of({k: v for k, v in options.items() if v is not None})
    train, test = ([with_units(t, nominal) for t in read_traces(paths)] for paths in (recordings, holdout))
    result = identify(nominal, train, test, chosen, np.random.default_rng(seed))
    target = out or model.with_name(f"{model.stem}.identified.toml")
    if target.resolve() == model.resolve():
        raise BadInput(f"--out {target}: the nominal model would be overwritten; another name is wanted")
    write_model(result.model, target)
    page = target.with_suffix(".html")
    page.write_text(identify_page(result), encoding="utf-8")
    return {**result.json(str(target)), "report": str(page)}
