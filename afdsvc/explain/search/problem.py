"""The recordings, the model and its nuisance parameters as one problem: residuals at a point, at a horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit, types

from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.dataset.experiment import Run
from afdsvc.explain.noise.weighting import Weighting
from afdsvc.explain.settings import Mapper, Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.predictor import driven
from afdsvc.explain.simulate.simulator import Simulated, Simulator
from afdsvc.lti.statespace import Array

LOST = 1e3  # residual, in rms of the output, where a simulation has left
FEW = 4  # recordings that stand for all of them where these are long
_V, _M = types.float64[::1], types.float64[:, ::1]


@njit(types.void(_M, _M, _V, _V, _M), cache=True, nogil=True, error_model="numpy")
def _residual(Y, y, offset, scale, e):  # type: ignore[no-untyped-def]
    """Write ``(Y - y - offset) / scale`` into ``e (n, p)``: 0 where a reading is missing, `LOST` where the simulation left."""
    for k in range(Y.shape[0]):
        for j in range(Y.shape[1]):
            v = (Y[k, j] - (y[k, j] + offset[j])) / scale[j]
            e[k, j] = v if abs(v) < LOST else (LOST if np.isfinite(Y[k, j]) else 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """Numbers of the model ``theta`` (stated standard deviations), initial state per run, sensor offsets ``(p,)``, effects."""

    theta: Array
    x0: tuple[Array, ...]
    offset: Array
    effects: tuple[PlacedEffect, ...] = ()

    def added(self, effect: PlacedEffect) -> Point:
        """Return the point with one more effect."""
        return replace(self, effects=(*self.effects, effect))

    def begun(self, k: int) -> list[Array]:
        """Return what the memory of every effect begins recording ``k`` with."""
        return [e.begun[k] if e.begun else np.zeros(0) for e in self.effects]

    def rested(self, x0: Sequence[Array]) -> Point:
        """Return the point for other recordings, begun in these states with memories at zero."""
        return replace(self, x0=tuple(x0), effects=tuple(replace(e, begun=()) for e in self.effects))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What every fit shares.

    ``scale (p,)`` is the rms of the outputs about their mean, ``state_scale (n,)`` that of the simulated states; ``x0`` the
    initial states guessed from the recordings; ``gains`` the predictor gain ``(n, p)`` of every horizon (zero: simulation).
    ``loads`` are the unknown loads every fit has, ``offset_free`` whether sensor offsets are free,
    ``regular`` whether the simulation forgets its start. ``closed`` simulates the loop with the stated controller. ``substeps`` of a sample are taken
    at least. ``mapper`` works out the columns of a Jacobian.
    """

    nominal: Nominal
    runs: tuple[Run, ...]
    scale: Array
    state_scale: Array
    x0: tuple[Array, ...]
    gains: Mapping[float, Array]
    weighting: Weighting
    settings: Settings
    loads: tuple[PlacedEffect, ...] = ()
    offset_free: bool = True
    regular: bool = True
    closed: bool = False
    ramped: bool = False
    substeps: int = 1
    mapper: Mapper = map

    def start(self) -> Point:
        """Return the model as stated, with the initial states guessed from the recordings."""
        return Point(np.zeros(len(self.nominal.entries)), self.x0, np.zeros(len(self.scale)), self.loads)

    def simulated(self, point: Point, horizon: float) -> list[Simulated]:
        """Return the simulation of every run; the offset is in the outputs."""
        return [Simulated(s.y + point.offset, s.u, s.x) for s in self._simulated(point, horizon)]

    def _simulated(self, point: Point, horizon: float, outputs_only: bool = False) -> list[Simulated]:
        simulator, found = Simulator(self.nominal, self.gains[horizon], self.ramped, self.substeps), []
        read = self.closed or bool(self.gains[horizon].any())  # else the simulation reads neither outputs nor references
        for k, (run, x0) in enumerate(zip(self.runs, point.x0, strict=True)):
            there = replace(run, Y=run.fresh - point.offset, REF=run.REF - point.offset) if read else run
            s = simulator.run(there, point.theta, x0, point.effects, closed=self.closed, begun=point.begun(k), outputs_only=outputs_only)
            found.append(s if run.taken is None else Simulated(run.shown(s.y), s.u, s.x))
        return found

    def residuals(self, point: Point, horizon: float) -> list[Array]:
        """Return ``(y - yhat) / scale`` of every run, ``(n, p)``; 0 where a reading is missing, `LOST` where the simulation left."""
        found = []
        for run, s in zip(self.runs, self._simulated(point, horizon, outputs_only=True), strict=True):
            found.append(np.empty_like(s.y))
            _residual(run.Y, s.y, point.offset, self.scale, found[-1])
        return found

    def size(self, signal: Signal) -> float:
        """Return the size of a signal: the largest value of an input or an auxiliary signal, the rms of a state or an output, a parameter as stated."""
        if signal.kind == "p":
            return abs(list(self.nominal.model.parameters.values())[signal.index].value) or 1.0
        if signal.kind in ("u", "aux"):
            return max(float(np.abs((r.U if signal.kind == "u" else r.AUX)[:, signal.index]).max(initial=0.0)) for r in self.runs) or 1.0
        return float((self.state_scale if signal.kind == "x" else self.scale)[signal.index])

    def resting(self) -> tuple[Array, ...]:
        """Return the smallest initial states that have the first readings: those of machines that begin at rest."""
        unit = self.state_scale
        back = unit[:, None] * np.linalg.pinv(self.nominal.plant.C * unit)
        return tuple(np.asarray(back @ np.nan_to_num(r.Y[0])) for r in self.runs)

    def of(self, runs: Sequence[Run], x0: Sequence[Array]) -> Problem:
        """Return the same problem on other runs."""
        return replace(self, runs=tuple(runs), x0=tuple(x0))

    @property
    def effort(self) -> int:
        """How many times the work of long recordings these allow: the root of the ratio of `Settings.screened` to their samples, at least 1."""
        return max(1, int(np.sqrt(self.settings.screened / max(1, sum(len(r) for r in self.runs)))))

    def beginning(self) -> Problem:
        """Return the problem on `Settings.screened` samples, itself where it has no more: the beginnings of `FEW` recordings, evenly spread, the first sample of the others."""
        lengths = np.array([len(r) for r in self.runs])
        few, parts = np.unique(np.linspace(0, len(lengths) - 1, FEW).astype(int)), np.ones_like(lengths)
        parts[few] = np.maximum(1, lengths[few] * min(1.0, self.settings.screened / max(1, lengths[few].sum())))
        return self if lengths.sum() <= self.settings.screened else self.of([r.span(0, int(n)) for r, n in zip(self.runs, parts, strict=True)], self.x0)


def loop_known(problem: Problem) -> bool:
    """Whether the loop can be closed around the simulated plant: controller and what was added to its output are known, it saw every sample, D is zero."""
    known = problem.nominal.model.controller is not None and all(r.W is not None and r.taken is None for r in problem.runs)
    return known and not problem.nominal.plant.D.any()


NUISANCE = "nuisance"  # family of effects that are part of every hypothesis and have a prior: their scale is its standard deviation


def unknown_load(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A constant force."""
    out[0] += p[0]


def loads(nominal: Nominal, force: Array, share: float) -> tuple[PlacedEffect, ...]:
    """Return a constant load on every driven state, zero at first, with a prior of ``share`` of the nominal force there."""
    found, model = [], nominal.model
    for i in np.flatnonzero(np.where(driven(model, nominal.plant.order), force, 0.0) > 0):
        name = model.states[i].name if i < len(model.states) else f"x{i}"
        j = int(np.argmax(np.abs(nominal.plant.B[i]))) if model.inputs else None
        unit, through = ("", None) if j is None else (model.inputs[j].unit, (int(i), j))
        size = Coefficient("load", unit, -np.inf, np.inf, share * float(force[i]), linear=True, through=through)
        signal = Signal("x", int(i))
        found.append(PlacedEffect(Hypothesis(NUISANCE, f"state:{name}", NUISANCE, "force", unknown_load, (signal,), (signal,), (size,), ((0.0,),)), np.zeros(1)))
    return tuple(found)
