"""The machine as the recordings show it: what hypotheses may know when they choose their sites and starting points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.physics import Axis, Machine, Size
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.resolution import grid
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.nominal import continuous
from afdsvc.explain.settle import raw
from afdsvc.lti.statespace import Array, StateSpace


def machine(base: Baseline, tones: Sequence[float] = (), peaks: Sequence[float] = ()) -> Machine:
    """Return the machine seen along the predicted trajectories of the training runs."""
    objective, point = base.objective, base.point
    model, runs = base.nominal.model, objective.runs
    simulated = [objective.simulator.run(r, point.theta, x0, point.effects) for r, x0 in zip(runs, point.x0, strict=True)]
    x = np.vstack([s.x for s in simulated])
    plant = base.nominal.plant
    smooth = continuous(plant) if plant.discrete else plant
    states = _sizes(model.states, x)
    inputs = _sizes(model.inputs, np.vstack([r.U for r in runs]))
    aux = np.vstack([r.AUX for r in runs])
    e = np.vstack(raw(objective, point))
    return Machine(
        inputs, _sizes(model.outputs, np.vstack([r.Y for r in runs])), states,
        tuple(_axes(model.states, states, inputs, smooth, x)),
        dict(zip(runs[0].aux, _sizes([Variable(a) for a in runs[0].aux], aux), strict=True)),
        runs[0].dt, sum(len(r) for r in runs) * runs[0].dt, bandwidth(runs), smooth, np.sqrt((e**2).mean(0)), tuple(tones), tuple(peaks),
        "noise" if base.limited == "noise" else "model",
    )


def _sizes(variables: Sequence[Variable], values: Array) -> tuple[Size, ...]:
    found = []
    for i, v in enumerate(variables):
        column = values[:, i][np.isfinite(values[:, i])]
        peak = float(np.abs(column).max(initial=0.0))
        found.append(Size(i, v.name, v.unit, float(column.mean()), float(column.std()) or peak or 1.0, peak, grid(column)))
    return tuple(found)


def _axes(
    variables: Sequence[Variable], states: Sequence[Size], inputs: Sequence[Size], plant: StateSpace | None, x: Array
) -> list[Axis]:
    names = [v.name for v in variables]
    found = []
    for i, v in enumerate(variables):
        if v.rate_of not in names or plant is None:
            continue
        j = names.index(str(v.rate_of))
        terms = np.concatenate([np.abs(plant.A[i]) * [s.rms for s in states], np.abs(plant.B[i]) * [s.rms for s in inputs]])
        direct = int(np.argmax(np.abs(plant.B[i]) * [s.rms for s in inputs])) if np.abs(plant.B[i]).any() else None
        gain = float(plant.B[i, direct]) if direct is not None else 1.0
        push = float(terms.max()) or 1.0
        found.append(Axis(v.name, states[j], states[i], push, direct, gain, inputs[direct].unit if direct is not None else ""))
    return found


def bandwidth(runs: Sequence[Run]) -> float:
    """Return the angular frequency [rad/s] below which 99 % of the input's power lies."""
    power: Array = np.zeros(16385)
    for r in runs:
        n = min(len(r), 16384)
        spectrum = (np.abs(np.fft.rfft((r.U - r.U.mean(0))[:n] * np.hanning(n)[:, None], 32768, axis=0)) ** 2).sum(1)
        power = power + spectrum
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    k = int(np.searchsorted(share, 0.99)) + 1
    return float(min(k, 16384) * 2 * np.pi / (32768 * runs[0].dt))
