"""The error of a model on recordings that were not fitted: simulated, only the initial states looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from afdsvc.dataset.experiment import Run
from afdsvc.explain.search.build import initial
from afdsvc.explain.search.fit import Coordinates
from afdsvc.explain.search.problem import Point, Problem
from afdsvc.lti.statespace import Array

PASSES = 4


def on(problem: Problem, runs: Sequence[Run]) -> Problem:
    """Return the same problem on other runs, their initial states guessed from their first samples."""
    there = problem.of(runs, [np.zeros(problem.nominal.plant.order) for _ in runs])
    return replace(there, x0=tuple(initial(there, k) for k in range(len(runs))))


def played_back(problem: Problem, point: Point, horizon: float = 0.0) -> tuple[list[Array], list[Array]]:
    """Return the simulated outputs of every run ``(n, p)`` and the initial states that fit them best."""
    runs, states = [], []
    for k, x0 in enumerate(problem.x0):
        one = problem.of([problem.runs[k]], [x0])
        there = _begun(one, point.rested([x0]), horizon)
        runs.append(one.simulated(there, horizon)[0].y)
        states.append(there.x0[0])
    return runs, states


def error(problem: Problem, point: Point, horizon: float = 0.0) -> float:
    """Return the NRMSE in percent over all runs, the mean over outputs."""
    outputs, _ = played_back(problem, point, horizon)
    e = np.vstack([r.Y - y for r, y in zip(problem.runs, outputs, strict=True)])
    spread = np.sqrt(np.mean([np.nanvar(r.Y, axis=0) for r in problem.runs], axis=0))
    return float(100 * np.mean(np.sqrt(np.nanmean(e**2, axis=0)) / spread))


def _begun(problem: Problem, point: Point, horizon: float) -> Point:
    """Return the point with the initial state of the only run, and what memories begin with, by damped Gauss-Newton."""
    c = Coordinates(problem, point)
    q, local = c.pack(point), slice(c.shared, c.size)

    def moved(x: Array) -> Point:
        return c.unpack(np.concatenate([q[: c.shared], x]))

    def residual(x: Array) -> Array:
        return problem.residuals(moved(x), horizon)[0].ravel()

    x = q[local]
    e, damping = residual(x), 1e-6
    for _ in range(PASSES if len(x) else 0):
        J = np.column_stack([(residual(x + 1e-3 * row) - e) / 1e-3 for row in np.eye(len(x))])
        H = J.T @ J + 1e-6 * len(e) * np.eye(len(x))
        for _ in range(4):
            step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), J.T @ e)
            there = residual(x + step)
            if there @ there < e @ e:
                x, e, damping = x + step, there, damping / 10
                break
            damping = max(10 * damping, 1e-3)
        else:
            break
    return moved(x)
