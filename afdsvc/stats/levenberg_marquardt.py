"""Levenberg-Marquardt on normal equations that are expensive to make and small to solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.statespace import Array

#: Longest step in any coordinate; callers scale coordinates so that 1 is a typical change.
REACH = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """Cost, gradient ``(q,)`` and positive semidefinite curvature ``(q, q)`` at a point."""

    cost: float
    gradient: Array
    curvature: Array


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the descent ended: point, what holds there, steps taken, and whether it converged."""

    point: Array
    local: Local
    steps: int
    converged: bool


def descend(
    evaluate: Callable[[Array], Local],
    start: Array,
    lower: Array,
    upper: Array,
    steps: int = 60,
    tolerance: float = 1e-5,
) -> Minimum:
    """Return a local minimum from ``start`` inside the bounds.

    ``evaluate`` may raise `IllConditioned` where there is no model (the step is then shortened); a step that would
    leave the bounds is shortened to touch them and the coordinate held there while it pushes outwards. Converged when
    the decrease still promised is below ``tolerance`` times ``max(1, ...)`` of a log-likelihood, that is statistically
    nothing.
    """
    if ((start < lower) | (start > upper)).any():
        k = int(np.flatnonzero((start < lower) | (start > upper))[0])
        raise BadInput(
            f"start value {start[k]:.6g} of coordinate {k} lies outside its bounds {lower[k]:.6g} to {upper[k]:.6g}"
        )
    point, local, damping = start, evaluate(start), 1e-3
    for taken in range(steps):
        free = ~(((point <= lower) & (local.gradient > 0)) | ((point >= upper) & (local.gradient < 0)))
        moved = False
        for _ in range(25):
            step, promised = _step(local, free, damping)
            if promised < tolerance:
                return Minimum(point, local, taken, True)
            tried = np.clip(point + step * min(1.0, REACH / max(float(np.abs(step).max()), 1e-300)), lower, upper)
            better = _better(evaluate, tried, local)
            if better is not None:
                point, local, damping, moved = tried, better, damping / 5, True
                break
            damping *= 4
        if not moved:
            return Minimum(point, local, taken, False)
    return Minimum(point, local, steps, False)


def _step(local: Local, free: NDArray[np.bool_], damping: float) -> tuple[Array, float]:
    """Return the damped Gauss-Newton step in the free coordinates and the decrease it promises."""
    g, H = local.gradient[free], local.curvature[np.ix_(free, free)]
    diagonal = np.diag(H).copy()
    diagonal[diagonal <= 0] = max(float(diagonal.max(initial=0.0)), 1.0) * 1e-9
    # Scaled by the diagonal, so that parameters of any size are treated alike.
    root = np.sqrt(diagonal)
    scaled = H / np.outer(root, root) + damping * np.eye(len(g))
    solution = -np.linalg.solve(scaled, g / root) / root
    step = np.zeros(len(local.gradient))
    step[free] = solution
    return step, float(-(g @ solution) - 0.5 * solution @ H @ solution)


def _better(evaluate: Callable[[Array], Local], tried: Array, local: Local) -> Local | None:
    try:
        found = evaluate(tried)
    except IllConditioned:
        return None
    return found if np.isfinite(found.cost) and found.cost < local.cost else None
