"""Columns, units and sampling of recordings against the model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.finding import Finding


def columns(model: Model, traces: Sequence[Trace], runs: Sequence[Run]) -> Iterator[Finding]:
    """Yield what there is to say on columns and sampling; missing ones were refused before."""
    seconds = sum(len(r) for r in runs) * runs[0].dt
    yield Finding(
        "ok", "columns",
        f"{len(runs)} recordings, {seconds:.4g} s at {1 / runs[0].dt:.6g} Hz; inputs {_names(model.inputs)}, outputs {_names(model.outputs)}",
    )
    yield from _unused(model, traces)
    yield from _units(model, traces)
    yield from _bridged(traces)
    yield from _sampling(model, runs[0].dt)


def _names(variables: Sequence[object]) -> str:
    return ", ".join(getattr(v, "name", "") for v in variables)


def _unused(model: Model, traces: Sequence[Trace]) -> Iterator[Finding]:
    known = {f"u_{v.name}" for v in model.inputs} | {f"y_{v.name}" for v in model.outputs}
    extra = sorted({c.name for t in traces for c in t.channels if c.role in ("u", "y") and c.name not in known})
    if extra:
        yield Finding("warning", "columns", f"columns {', '.join(extra)} are in the recordings but not in the model and are not used")


def _units(model: Model, traces: Sequence[Trace]) -> Iterator[Finding]:
    wanted = {f"u_{v.name}": v.unit for v in model.inputs} | {f"y_{v.name}": v.unit for v in model.outputs}
    for trace in traces:
        for channel in trace.channels:
            unit = wanted.get(channel.name, "")
            if unit and channel.unit and unit != channel.unit:
                yield Finding(
                    "warning", "units", f"{trace.name}: {channel.name} is recorded in {channel.unit}; the model has it in {unit}"
                )


def _bridged(traces: Sequence[Trace]) -> Iterator[Finding]:
    for trace in traces:
        for channel in trace.channels:
            missing = int((~np.isfinite(trace.column(channel.name))).sum()) if channel.role in ("aux", "ref") else 0
            if missing:
                yield Finding(
                    "warning", "gaps", f"{trace.name}: {channel.name} lacks {missing} of {len(trace)} samples; they are interpolated linearly"
                )


def _sampling(model: Model, dt: float) -> Iterator[Finding]:
    plant, K = model.plant, model.controller
    if plant is not None and plant.discrete and abs(plant.dt / dt - 1) > 1e-6:
        yield Finding(
            "warning", "sampling",
            f"the model is sampled every {plant.dt:g} s, the recordings every {dt:g} s: the model is resampled by way of its "
            "continuous counterpart",
        )
    if K is not None and K.order and K.discrete and abs(K.dt / dt - 1) > 1e-6:
        yield Finding(
            "warning", "sampling",
            f"the controller is sampled every {K.dt:g} s, the recordings every {dt:g} s: the loop cannot be reconstructed and the "
            "controller is treated as unknown",
        )
