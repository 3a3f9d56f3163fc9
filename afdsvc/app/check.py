"""`afdsvc check`: what can be said of a model and its recordings before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from afdsvc.api.model import Model
from afdsvc.app.explain import ExplainOptions, from_rest, load_library, traces
from afdsvc.errors import BadInput
from afdsvc.explain.check.result import CheckResult, check_all
from afdsvc.explain.simulate.nominal import nominal as sampled
from afdsvc.files.open import open_model
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.unfinished import writing


def check_files(model: Path, recordings: Sequence[Path], options: ExplainOptions, page: Path | None = None) -> tuple[CheckResult, dict[str, Any]]:
    """Check files; writes an HTML page and returns the result and ``check --json``.

    ``page`` is where the page goes, beside the model by default. Raises `BadInput` for files that cannot be read; what does not fit
    between them is a finding.
    """
    nominal, beside = open_model(model, options.allow_code, options.machine)
    if not recordings and beside is None:
        raise BadInput(f"{model}: {_stated(nominal)} is in order, but no recording is given to compare it with; expected at least one")
    data = from_rest(traces(recordings or ([beside] if beside else []), nominal, options), nominal)
    result = check_all(nominal, data, load_library())
    target = page or model.with_name(f"{model.stem}.check.html")
    document = {**result.json(), "data": prepared(data), "report": str(target)}
    from afdsvc.present.html.check_page import check_page  # imports matplotlib

    with writing(target):
        target.write_text(check_page(result, document), encoding="utf-8")
    return result, document


def _stated(model: Model) -> str:
    """Return what a model states, in words, and where it has poles; raises `BadInput` where its code fails."""
    plant = sampled(model, model.sample_time or 1.0).plant
    sides = f"{', '.join(v.name for v in model.inputs) or 'no input'} to {', '.join(v.name for v in model.outputs)}"
    poles = ", ".join(f"{p:.4g}".removesuffix("+0j").removesuffix("-0j") for p in plant.poles())
    return f"the model '{model.name}' (from {sides}; poles {poles or 'none'}{'' if plant.discrete or not poles else ' rad/s'})"
