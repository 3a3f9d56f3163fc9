"""The stepped simulator and its linear part, both compared with recordings and with each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.model import Model, SteppedPlant
from afdsvc.api.signals import Trace
from afdsvc.errors import BadInput
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array

MOST_SAMPLES = 20_000


def compared(model: Model, traces: Sequence[Trace]) -> list[str]:
    """Return a sentence per recording on what the simulator behind a model makes of its inputs; [] where there is none.

    Both start from rest; errors are ``|y - yhat| / |y - mean|``, like everywhere. A failure of the simulator is reported, not raised.
    """
    if model.opened is None or model.plant is None:
        return []
    unit = model.opened()
    try:
        return [_sentence(model, unit, trace) for trace in traces]
    finally:
        unit.close()


def _sentence(model: Model, unit: SteppedPlant, trace: Trace) -> str:
    n = min(len(trace), MOST_SAMPLES)
    u = np.column_stack([trace.column(f"u_{v.name}")[:n] for v in model.inputs])
    y = np.column_stack([trace.column(f"y_{v.name}")[:n] for v in model.outputs])
    try:
        real = _simulated(unit, u, trace.dt)
    except BadInput as error:
        return f"{trace.name}: the simulator itself could not follow the recorded inputs: {error}"
    plant = model.plant
    assert plant is not None  # noqa: S101 - looked at by the caller
    sampled = plant if plant.discrete else sample_zoh(plant, trace.dt)
    linear, _ = simulate(sampled, u)
    parts = [
        f"{v.name} {100 * _nrmse(y[:, i], real[:, i]):.3g} % by the simulator itself, {100 * _nrmse(y[:, i], linear[:, i]):.3g} % by its linear part "
        f"(the two differ by {100 * round(_nrmse(real[:, i], linear[:, i]), 9):.2g} %)"
        for i, v in enumerate(model.outputs)
    ]
    return f"{trace.name}, simulated from its inputs and from rest, error over variation: {'; '.join(parts)}"


def _simulated(unit: SteppedPlant, u: Array, dt: float) -> Array:
    rest = unit.begin()
    y = [rest, *(unit.advance(held, dt) for held in u[:-1])]
    return np.array(y) - rest


def _nrmse(measured: Array, simulated: Array) -> float:
    there = np.isfinite(measured)
    variation = float(np.sqrt(np.square(measured[there] - measured[there].mean()).sum()))
    error = float(np.sqrt(np.square(measured[there] - simulated[there]).sum()))
    return error / variation if variation else float(error > 0)
