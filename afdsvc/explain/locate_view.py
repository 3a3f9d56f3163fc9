"""What location looks at: residuals of a baseline over all runs, the motion without noise, and what the nuisance can imitate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.fit import moved
from afdsvc.explain.locate_motion import motion
from afdsvc.explain.locate_sweep import unwhitened
from afdsvc.explain.objective import Objective, Point, Tangent, tangent
from afdsvc.explain.simulator import Simulated
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The residuals ``raw`` (outputs' units) per run, the ``motion`` at ``point``, and the tangent there.

    The nuisance is at its best for all runs together: ``raw`` is the tangent's residual, no longer whitened.
    """

    base: Baseline
    runs: tuple[Run, ...]
    point: Point
    raw: tuple[Array, ...]
    motion: tuple[Simulated, ...]
    tangent: Tangent

    @property
    def objective(self) -> Objective:
        """The objective over all runs."""
        return self.tangent.objective

    @property
    def counts(self) -> float:
        """How many independent numbers the residual is worth."""
        return self.objective.samples / self.base.memory

    @property
    def power(self) -> Array:
        """Mean square of the residual per output, shape ``(p,)``."""
        return np.asarray(np.mean(np.vstack(self.raw) ** 2, axis=0))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(v.name for v in self.base.nominal.model.outputs)


def view(base: Baseline, more: Sequence[Run] = ()) -> View:
    """Return the view of a baseline's runs and some ``more`` that were not fitted, whose initial states are found here."""
    runs = (*base.objective.runs, *more)
    objective = replace(base.objective, runs=runs)
    n = base.nominal.plant.order
    point = replace(base.point, x0=(*base.point.x0, *(np.zeros(n) for _ in more)))
    here = tangent(objective, point)
    started = moved(point, here.shift(here.full))
    moving = tuple(motion(objective.simulator, r, point, x0) for r, x0 in zip(runs, started.x0, strict=True))
    return View(base, runs, point, tuple(per_run(here.rest, objective)), moving, here)


def per_run(rows: Array, objective: Objective) -> list[Array]:
    """Return whitened rows of all runs (prior rows may follow) as one array ``(n, p)`` per run, in the outputs' units."""
    out, start = [], 0
    for run in objective.runs:
        out.append(unwhitened(objective.whitener, rows[start : start + run.Y.size].reshape(run.Y.shape)))
        start += run.Y.size
    return out
