"""The machine as the recordings show it: what hypotheses may know when they choose sites and starting points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from afdsvc.api.model import Variable
from afdsvc.api.physics import MOST_SIGNALS, Axis, Hypothesis, Machine, Physics, Signal, Size
from afdsvc.dataset.experiment import Run
from afdsvc.dataset.glitches import grid
from afdsvc.dataset.screening import LEAST
from afdsvc.dataset.units import is_velocity
from afdsvc.explain.search.fit import Fit
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.search.ranking import is_constant
from afdsvc.explain.simulate.nominal import PARAMETER, Nominal
from afdsvc.lti.sampling import continuous
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.stats.waves import wave_numbers

SIDE, SIDES = 0.05, (1, 99)  # of a signal's peak, from which on it is on a side; percentiles of its values that are compared with that
MOVED = 0.05  # of what pushes an axis, from which on a signal moves it, too
ALIKE = 0.1  # relative difference of what two signals do to the axes, up to which they act alike
EXCITED = 0.99  # share of the input's power below the bandwidth


def hypotheses(library: Sequence[Physics], machine: Machine, corrected: bool = False) -> list[Hypothesis]:
    """Return the hypotheses of every physics at every site where it makes sense, forces on coupled axes also as they move all of these.

    Where a predictor is ``corrected`` by the outputs, the gain of a sensor acts as a stronger correction. It is left out: what the
    plant shows of it is a product with the gains of the actuators. So are laws that read more signals than the simulation carries.
    """
    found = [shape for physics in library for h in physics.hypotheses(machine) for shape in (h, *through_mechanism(h, machine))]
    return [h for h in found if len(h.reads) <= MOST_SIGNALS and not (corrected and is_constant(h) and h.stage == "output")]


def machine(problem: Problem, base: Fit, horizon: float, tones: Sequence[float] = (), peaks: Sequence[float] = (), limited: str = "model") -> Machine:
    """Return the machine along the trajectories of a fit."""
    model, runs = problem.nominal.model, problem.runs
    made = problem.simulated(base.point, horizon)
    x, y = np.vstack([s.x for s in made]), np.vstack([s.y for part in (made, problem.simulated(problem.start(), horizon)) for s in part])
    plant = problem.nominal.plant
    smooth = continuous(plant) if plant.discrete else plant
    states = _sizes(model.states, x)
    inputs = _sizes(model.inputs, np.vstack([r.U for r in runs]))
    aux = np.vstack([r.AUX for r in runs])
    residuals = problem.residuals(base.point, horizon)
    e = np.vstack(residuals) * problem.scale
    axes = tuple(_axes(model.states, states, inputs, smooth, x))
    read = _sizes(model.outputs, np.vstack([r.Y for r in runs]))
    # A sensor may have lost the sign; numbers of the model that were fitted to what it says may have lost it, too.
    outputs = tuple(replace(o, reverses=o.reverses or _reverses(y[np.isfinite(y[:, o.index]), o.index])) for o in read)
    ways = {Signal("x", a.position.index): [s.x[:, a.position.index] for s in made[: len(runs)]] for a in axes if a.position}
    ways |= {Signal("y", o.index): [r.Y[:, o.index] for r in runs] for o in outputs}
    ways |= {Signal("u", u.index): [np.cumsum(r.U[:, u.index]) * r.dt for r in runs] for u in inputs if is_velocity(u.unit)}
    return Machine(
        inputs, outputs, states, axes,
        dict(zip(runs[0].aux, _sizes([Variable(a) for a in runs[0].aux], aux), strict=True)), runs[0].dt, sum(len(r) for r in runs) * runs[0].dt,
        bandwidth(runs), smooth, np.sqrt((e**2).mean(0)), tuple(tones), tuple(peaks), "noise" if limited == "noise" else "model",
        _deflections(axes, smooth, x), {signal: wave_numbers(way, residuals) for signal, way in ways.items()}, problem.nominal.python, _parameters(problem.nominal),
        any((r.U[len(r) // 2 :].std(0) > SIDE * r.U.std(0)).any() for r in runs), (runs[0].begins, runs[-1].begins + len(runs[-1]) * runs[-1].dt), len(runs),
    )


def _sizes(variables: Sequence[Variable], values: Array) -> tuple[Size, ...]:
    found = []
    for i, v in enumerate(variables):
        column = values[:, i][np.isfinite(values[:, i])]
        peak = float(np.abs(column).max(initial=0.0))
        found.append(Size(
            i, v.name, v.unit, float(column.mean()), next((s for s in (float(column.std()), peak) if s > LEAST), 1.0), peak, grid(column), float(column.min()) if len(column) else 0.0,
            _reverses(column),
        ))
    return tuple(found)


def _parameters(nominal: Nominal) -> tuple[Size, ...]:
    """Return the numbers of Python code that are not known exactly."""
    stated = list(nominal.model.parameters.values())
    uncertain = [(e, stated[e.row]) for e in nominal.entries if e.matrix == PARAMETER]
    return tuple(Size(e.row, e.name, q.unit, q.value, e.sd, abs(q.value), reverses=False) for e, q in uncertain)


def _reverses(values: Array) -> bool:
    """Whether a signal takes both signs, by more than noise about rest."""
    if not len(values):
        return False
    low, high = np.percentile(values, SIDES)
    return bool(min(-low, high) > SIDE * np.abs(values).max())


def _deflections(axes: Sequence[Axis], plant: StateSpace | None, x: Array) -> dict[tuple[int, int], Size]:
    """Return the differences of positions of one unit that the model's matrix couples."""
    found: dict[tuple[int, int], Size] = {}
    for a, b in combinations(axes, 2):
        p, q = a.position, b.position
        if plant and p and q and p.unit == q.unit and (plant.A[a.rate.index, q.index] or plant.A[b.rate.index, p.index]):
            (found[p.index, q.index],) = _sizes([Variable(f"{p.name} - {q.name}", p.unit)], x[:, [p.index]] - x[:, [q.index]])
    return found


def _axes(variables: Sequence[Variable], states: Sequence[Size], inputs: Sequence[Size], plant: StateSpace | None, x: Array) -> list[Axis]:
    """Return the axes: states that are the rate of another one, and measured speeds whose position is not a state."""
    names = [v.name for v in variables]
    located = [names.index(v.rate_of) for v in variables if v.rate_of in names]
    found = []
    for i, v in enumerate(variables):
        if plant is None or not (v.rate_of in names or (v.rate_of is None and is_velocity(v.unit))):
            continue
        position = states[names.index(str(v.rate_of))] if v.rate_of in names else None
        found.append(_axis(v.name, position, states[i], inputs, plant, x, located))
    return found


def _axis(name: str, position: Size | None, rate: Size, inputs: Sequence[Size], plant: StateSpace, x: Array, located: Sequence[int]) -> Axis:
    i = rate.index
    springs, others = x[:, located] @ plant.A[i, located], np.delete(x * plant.A[i], located, axis=1)  # springs between positions that wander cancel
    by_state = np.sqrt(np.nanmean(np.column_stack([springs, others]) ** 2, axis=0))
    by_input = np.abs(plant.B[i]) * [np.hypot(s.rms, s.mean) for s in inputs]
    push = float(np.concatenate([by_state, by_input]).max(initial=0.0)) or 1.0
    direct = int(np.argmax(by_input)) if by_input.any() else None
    if direct is None:
        return Axis(name, position, rate, push)
    return Axis(name, position, rate, push, direct, float(plant.B[i, direct]), inputs[direct].unit)


def bandwidth(runs: Sequence[Run]) -> float:
    """Return the angular frequency [rad/s] below which nearly all of the input's power lies; of the outputs' where no input moves."""
    power, driven = np.zeros(16385), any(np.ptp(r.U, axis=0).any() for r in runs)
    for r in runs:
        signal = r.U if driven else np.nan_to_num(r.Y)
        n = min(len(r), 16384)
        power = power + (np.abs(np.fft.rfft((signal - signal.mean(0))[:n] * np.hanning(n)[:, None], 32768, axis=0)) ** 2).sum(1)
    share = np.cumsum(power) / max(float(np.sum(power)), 1e-300)
    k = int(np.searchsorted(share, EXCITED)) + 1
    return float(min(k, 16384) * 2 * np.pi / (32768 * runs[0].dt))


def through_mechanism(h: Hypothesis, machine: Machine) -> list[Hypothesis]:
    """Return the shape of a force as it moves all axes of a mechanism; none where no input moves several.

    What one force does to all axes is known by what the model's own forces do: of a damper or a spring of the same axis (its velocity or its position in
    the model's matrix), or of the input where it acts alike, or where the axis has neither. Of code only inputs are followed: what a state does there is
    more than a force.
    """
    axis = next((a for a in machine.axes if h.stage == "force" and [s.index for s in h.writes] == [a.rate.index]), None)
    if axis is None or axis.input is None or machine.plant is None:
        return []
    port, A = machine.inputs[axis.input], machine.plant.A
    pushed = machine.plant.B[:, port.index] * math.hypot(port.rms, port.mean)
    if not _moves_others(pushed, axis, machine):
        return []
    own = next((s for s in _own(h, axis) if A[axis.rate.index, s.index]), None)
    if own is None or np.allclose(_shares(A[:, own.index], axis, machine), _shares(pushed, axis, machine), rtol=ALIKE):
        return [_along(h, Signal("u", port.index), port.name)]
    column = A[:, own.index] * (axis.push / A[axis.rate.index, own.index])
    return [_along(h, own, machine.states[own.index].name)] if not machine.code and _moves_others(column, axis, machine) else []


def _own(h: Hypothesis, axis: Axis) -> list[Signal]:
    """Return velocity and position of an axis, first the one that the law reads."""
    both = [Signal("x", s.index) for s in (axis.rate, axis.position) if s]
    return sorted(both, key=lambda s: s not in h.reads)


def _moves_others(column: Array, axis: Axis, machine: Machine) -> bool:
    """Whether accelerations are a share of what pushes any other axis."""
    return any(abs(column[a.rate.index]) > MOVED * a.push for a in machine.axes if a is not axis)


def _shares(column: Array, axis: Axis, machine: Machine) -> Array:
    """Return what acts on every axis, that on ``axis`` being 1."""
    return np.asarray(column[[a.rate.index for a in machine.axes]] / column[axis.rate.index])


def _along(h: Hypothesis, signal: Signal, name: str) -> Hypothesis:
    variant = h.notes.get("variant", "")
    notes = {**h.notes, "variant": f"{variant}; as {name} acts" if variant else f"as {name} acts", "of": h.notes.get("of", variant)}
    return replace(h, along=signal, linear=None, notes=notes)
