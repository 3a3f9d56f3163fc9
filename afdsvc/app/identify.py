"""`afdsvc identify` and `afdsvc design`: files in, reports and improved models out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model, write_model
from afdsvc.files.model.stepped import LINEARISED
from afdsvc.files.open import Naming, open_file
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.unfinished import writing
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.pipeline import identify


def _traces(paths: Sequence[Path], naming: Naming, model: Model) -> list[Trace]:
    """Return the traces of recordings (every gapless piece) and tables, in the model's units; empty cells of a table are missing samples."""
    return [trace for path in paths for trace in open_file(path, naming).traces(model, gaps=True)]


def identify_files(
    model: Path, recordings: Sequence[Path], holdout: Sequence[Path], out: Path | None, options: Mapping[str, Any], seed: int,
    allow_code: bool = False, naming: Naming = Naming(),
) -> dict[str, Any]:
    """Identify from files; writes the improved model and an HTML page beside it and returns ``identify --json``.

    A model's Python simulator runs only with ``allow_code``; its parameters are then fitted, linearised around rest.
    """
    nominal = read_model(model, allow_code)
    chosen = IdentifyOptions.of({k: v for k, v in options.items() if v is not None})
    train, test = (_traces(paths, naming, nominal) for paths in (recordings, holdout))
    result = identify(nominal, train, test, chosen, np.random.default_rng(seed))
    target = out or model.with_name(f"{model.stem}.identified.toml")
    if target.resolve() == model.resolve():
        raise BadInput(f"--out {target}: the nominal model would be overwritten; expected another name")
    page = target.with_suffix(".html")
    from afdsvc.present.html.identify_page import identify_page

    data = [*nominal.extra.get(LINEARISED, ()), *prepared([*train, *test])]
    with writing(page, target):
        page.write_text(identify_page(result, data=data), encoding="utf-8")
        write_model(result.model, target)  # last: with the model there, all is there
    document = result.json(str(target))
    return {**document, "notes": [*document["notes"], *data], "report": str(page)}


