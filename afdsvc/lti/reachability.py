"""States that the zeros of the matrices alone disconnect from every input or every output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afdsvc.lti.statespace import StateSpace


def trim(system: StateSpace) -> StateSpace:
    """Return the system without the states no input reaches or no output sees, judged by exact zeros only."""
    edges = system.A != 0
    reached = _closure(edges, (system.B != 0).any(axis=1))
    seen = _closure(edges.T, (system.C != 0).any(axis=0))
    keep = np.flatnonzero(reached & seen)
    if keep.size == system.order:
        return system
    return StateSpace(system.A[np.ix_(keep, keep)], system.B[keep], system.C[:, keep], system.D, system.dt)


def _closure(edges: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the nodes reached from ``start`` when ``edges[i, j]`` leads from j to i."""
    reached = start.copy()
    while True:
        grown = reached | (edges & reached[None, :]).any(axis=1)
        if (grown == reached).all():
            return reached
        reached = grown
