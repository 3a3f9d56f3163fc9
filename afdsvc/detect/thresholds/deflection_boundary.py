"""The boundary of a CUSUM that gains information faster than in a loop at rest.

Alarms come about in proportion to the information gained: with more of it than was expected (a reference moves) they would come too
often. So the boundary of each hypothesis moves as the information per block since its g last was zero demands: it rises at first, and falls where
steps are so large that few pass zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.detect.thresholds.average_run_length import boundary, run_length
from afdsvc.lti.statespace import Array

POINTS = 32  # of the table
LARGE = 8.0  # deflection per block beyond which no boundary is needed


@dataclass(frozen=True, slots=True, eq=False)
class DeflectionBoundary:
    """Boundary of one CUSUM of even steps by the deflection of a step: ``boundary (N,)`` at ``log_deflection (N,)``, both of them for
    one run length; ``expected (H,)`` is the logarithm of every hypothesis' deflection per block in a loop at rest, ``falls (H,)`` the information
    per block beyond which the boundary is below the one at rest."""

    log_deflection: Array
    boundary: Array
    expected: Array
    falls: Array

    @classmethod
    def of(cls, deflection: Array, looks: float) -> DeflectionBoundary:
        """Return the table for hypotheses with these deflections per look that alarm once in so many looks."""
        grid = np.geomspace(float(deflection.min()), max(LARGE, 2 * float(deflection.max())), POINTS)
        found = np.array([boundary(mu, looks) if 3 * run_length(mu, 1e-9) < looks else 0.0 for mu in grid.tolist()])
        low = found < np.interp(deflection, grid, found)[:, None]
        return cls(np.log(grid), found, np.log(deflection), grid[(low & (grid > deflection[:, None])).argmax(axis=1) - 1] ** 2)

    @classmethod
    def flat(cls, hypotheses: int) -> DeflectionBoundary:
        """Return the table that moves no boundary."""
        return cls(np.array([0.0, 1.0]), np.zeros(2), np.zeros(hypotheses), np.full(hypotheses, np.inf))

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """The arrays that `boundary_at` and what calls it take."""
        return self.log_deflection, self.boundary, self.expected, self.falls


@njit(cache=True)
def boundary_at(boundary, deflection, table, expected, gained, blocks):  # type: ignore[no-untyped-def]
    """Return the boundary of a hypothesis that gained so much information in so many blocks; ``boundary`` is the one at rest."""
    found = 0.5 * np.log(gained / blocks) if gained > 0.0 else expected
    if found <= expected:
        return boundary
    return max(boundary + np.interp(found, deflection, table) - np.interp(expected, deflection, table), 0.0)
