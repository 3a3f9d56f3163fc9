"""What the boundary of a CUSUM is raised by when it gains information faster than in a loop at rest.

Alarms come about in proportion to the information gained: with more of it than was expected (a reference moves) they would come too
often. So the boundary of each hypothesis rises as the information per block since its g last was zero demands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.detect.thresholds.average_run_length import boundary, run_length
from afdsvc.lti.statespace import Array

POINTS = 16  # of the table
LARGE = 8.0  # deflection per block beyond which no boundary is needed


@dataclass(frozen=True, slots=True, eq=False)
class DeflectionBoundary:
    """Boundary of one CUSUM of even steps by the deflection of a step: ``boundary (N,)`` at ``log_deflection (N,)``, both of them for
    one run length; ``expected (H,)`` is the logarithm of every hypothesis' deflection per block in a loop at rest."""

    log_deflection: Array
    boundary: Array
    expected: Array

    @classmethod
    def of(cls, deflection: Array, looks: float) -> DeflectionBoundary:
        """Return the table for hypotheses with these deflections per look that alarm once in so many looks."""
        grid = np.geomspace(float(deflection.min()), max(LARGE, 2 * float(deflection.max())), POINTS)
        found = [boundary(mu, looks) if 3 * run_length(mu, 1e-9) < looks else 0.0 for mu in grid.tolist()]
        return cls(np.log(grid), np.array(found), np.log(deflection))

    @classmethod
    def flat(cls, hypotheses: int) -> DeflectionBoundary:
        """Return the table that raises no boundary."""
        return cls(np.array([0.0, 1.0]), np.zeros(2), np.zeros(hypotheses))


@njit(cache=True)
def raised_by(deflection, boundaries, expected, gained, blocks):  # type: ignore[no-untyped-def]
    """Return what the boundary of a hypothesis is raised by when it gained so much information in so many blocks."""
    found = 0.5 * np.log(gained / blocks) if gained > 0.0 else expected
    return max(np.interp(found, deflection, boundaries) - np.interp(expected, deflection, boundaries), 0.0) if found > expected else 0.0
