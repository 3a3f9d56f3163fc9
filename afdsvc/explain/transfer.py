"""What the free numbers of the model took over from one changed constant, handed back to it.

Before anything is named the free numbers are refitted, each within its own uncertainty, and a change of one constant hides in
them: strained where a single entry can follow it, spread thinly where several together can. Naming that constant gives the
strain back. For a change that keeps the plant's structure this is a matter of matrices: given its size, the numbers that leave
the plant as the data want it are a linear least-squares problem, weighted with the data's own information.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from afdsvc.api.physics import Hypothesis
from afdsvc.explain.nominal import Nominal
from afdsvc.explain.objective import Point, Tangent
from afdsvc.explain.simulator import Effect
from afdsvc.lti.statespace import Array, StateSpace

FACTORS = np.geomspace(0.05, 8.0, 33)  # by which the constant is tried
MATRICES = ("A", "B", "C", "D")
Transferred = tuple[float, Hypothesis, Point]


def transfers(t: Tangent, hypotheses: Sequence[Hypothesis], worth: float) -> list[Transferred]:
    """Return what every change of a constant would save, by the predicted cost, where it saves at least ``worth``."""
    theta = t.point.theta
    if float(theta @ theta) < worth:
        return []
    weight = _information(t, len(theta))
    found = [x for h in hypotheses if h.physics == "parameter_change" and (x := _transfer(t, h, weight)) is not None]
    return sorted((x for x in found if t.cost - x[0] >= worth), key=lambda x: x[0])


def _information(t: Tangent, k: int) -> Array:
    """Return the factor W of what the data know of theta, ``W^T W``, initial states and effects eliminated, prior left out."""
    inverse = np.linalg.inv(t.r)
    known = np.linalg.inv(inverse[:k] @ inverse[:k].T) - np.eye(k)
    values, vectors = np.linalg.eigh((known + known.T) / 2)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def _transfer(t: Tangent, hypothesis: Hypothesis, weight: Array) -> Transferred | None:
    nominal, theta = t.objective.simulator.nominal, t.point.theta
    start = np.array(hypothesis.starts[0], float)
    j = next((j for j, c in enumerate(hypothesis.parameters) if c.free), None)
    if hypothesis.linear is None or j is None:
        return None

    def values(eta: float) -> Array:
        return np.concatenate([start[:j], [eta], start[j + 1 :]])

    def share(eta: float) -> tuple[float, Array]:
        return _handed_back(nominal, hypothesis, values(eta), weight, theta)

    tried = [f - 1 for f in FACTORS if hypothesis.parameters[j].low < f - 1 < hypothesis.parameters[j].high]
    costs = [share(eta)[0] for eta in tried]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        return None
    around = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
    eta = float(minimize_scalar(lambda x: share(x)[0], bounds=around, method="bounded").x)
    cost, there = share(eta)
    point = Point(there, t.point.x0, (*t.point.effects, Effect(hypothesis, values(eta))))
    return t.cost + cost - float(theta @ theta), hypothesis, point


def _handed_back(nominal: Nominal, hypothesis: Hypothesis, eta: Array, weight: Array, wanted: Array) -> tuple[float, Array]:
    """Return the least cost (information times distance from the ``wanted`` plant, plus prior) and the theta it is reached at."""
    assert hypothesis.linear is not None  # noqa: S101
    k, values = len(wanted), [float(v) for v in eta]
    origin = _entries(nominal, hypothesis.linear(nominal.at(np.zeros(k)), values))
    if origin is None:
        return np.inf, wanted
    columns = []
    for i in range(k):
        moved = _entries(nominal, hypothesis.linear(nominal.at(np.eye(k)[i]), values))
        if moved is None:
            return np.inf, wanted
        columns.append(moved - origin)
    left = np.vstack([weight @ np.column_stack(columns), np.eye(k)])
    right = np.concatenate([weight @ (wanted - origin), np.zeros(k)])
    theta, *_ = np.linalg.lstsq(left, right, rcond=None)
    return float(np.sum((left @ theta - right) ** 2)), theta


def _entries(nominal: Nominal, plant: StateSpace) -> Array | None:
    """Return the free numbers of a plant in standard deviations from nominal; None when a fixed one differs."""
    free = {(e.matrix, e.row, e.column) for e in nominal.entries}
    if any(place not in free for place in _differing(nominal.plant, plant)):
        return None
    moved = [getattr(plant, e.matrix)[e.row, e.column] - getattr(nominal.plant, e.matrix)[e.row, e.column] for e in nominal.entries]
    return np.array([float(m) / e.sd for m, e in zip(moved, nominal.entries, strict=True)])


def _differing(a: StateSpace, b: StateSpace) -> Iterator[tuple[str, int, int]]:
    for name in MATRICES:
        x, y = getattr(a, name), getattr(b, name)
        yield from ((name, int(i), int(j)) for i, j in np.argwhere(np.abs(x - y) > 1e-9 * np.maximum(np.abs(x), 1e-300)))
