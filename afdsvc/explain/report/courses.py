"""The recordings beside the simulations, before and after, and how well these fit what was held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.report.explanation import OutputFit, RecordingCourse
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.explain.verdict.holdout import Player, nrmse
from afdsvc.lti.statespace import Array
from afdsvc.stats.portmanteau import portmanteau_test


def courses(player: Player, runs: Sequence[Run], role: str, before: Point, after: Point) -> tuple[RecordingCourse, ...]:
    """Return the recordings beside the simulations of both models."""
    both = (player.outputs(runs, p) for p in (before, after))
    return tuple(RecordingCourse(r.name, role, _time(r), r.Y, b, a) for r, b, a in zip(runs, *both, strict=True))


def _time(run: Run) -> Array:
    return np.asarray(run.t0 + run.dt * np.arange(len(run)), dtype=np.float64)


def fits(held: Sequence[RecordingCourse], names: Sequence[str], floor: Sequence[float] | None) -> tuple[OutputFit, ...]:
    """Return the errors of every output on the held-out recordings, and the noise's."""
    y, before, after = (np.vstack([getattr(c, k) for c in held]) for k in ("measured", "before", "after"))
    errors = zip(names, nrmse(y, before), nrmse(y, after), strict=True)
    spread = np.maximum(np.nanstd(y, axis=0), 1e-300)
    return tuple(OutputFit(n, float(b), float(a), None if floor is None else floor[j] / float(spread[j])) for j, (n, b, a) in enumerate(errors))


def white(problem: Problem, held: Sequence[RecordingCourse]) -> tuple[float, float]:
    """Return the p-values of Hosking's test on the weighted residuals before and after; 0 where a simulation left."""
    return _white(problem, [c.residual_before for c in held]), _white(problem, [c.residual_after for c in held])


def _white(problem: Problem, residuals: Sequence[Array]) -> float:
    if any(np.isinf(e).any() for e in residuals):
        return 0.0
    weighted = [problem.weighting(np.nan_to_num(e / problem.scale)) for e in residuals]
    return portmanteau_test(np.vstack([w - w.mean(0) for w in weighted]))
