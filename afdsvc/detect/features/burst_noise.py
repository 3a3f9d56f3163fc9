"""The residual inside a burst beside its excited lines: is it as loud as the thresholds assume?

Quiet data say nothing about noise that only a burst brings (a pump that starts with it, a cable that rattles). In the steady part the
residual without lines and nuisances is the noise again, ``chi-squared`` with as many degrees of freedom as are left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.special import chdtr, chdtrc

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.features.demodulation import BasisSums, window
from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.lti.statespace import Array

FEWEST = 50  # samples of the steady part below which nothing is said


@dataclass(frozen=True, slots=True, eq=False)
class BurstNoise:
    """Energy of the normalised residual in the steady part of a burst, and its sums on the excited lines."""

    lines: BasisSums
    energy: float = 0.0

    @classmethod
    def start(cls, outputs: int) -> BurstNoise:
        """Return sums over nothing."""
        return cls(BasisSums(0, np.zeros((0, 0)), np.zeros((0, outputs))))

    def add(self, e: Array, block: ResidualBlock, first: int, burst: Burst, nuisances: Nuisances) -> BurstNoise:
        """Return the sums with the normalised residual ``e (n, p)`` of a block added; ``first`` counts from the beginning of the burst."""
        begin, end = window(burst)
        a, b = max(begin - first, 0), max(end - first, 0)
        if not burst.lines or not len(e[a:b]):
            return self
        angle = nuisances.angles(block)
        basis = nuisances.basis(tuple(sorted({line.omega for line in burst.lines})), angle is not None)
        sums = self.lines if self.lines.n else BasisSums.empty(basis, e.shape[1])
        sums = sums.add(basis, first + a, block.dt, e[a:b], None if angle is None else angle[a:b])
        return replace(self, lines=sums, energy=energy(np.ascontiguousarray(e[a:b]), self.energy))

    def loudness(self, level: float, estimated: int) -> tuple[float, float]:
        """Return the variance beside the lines over that stated, 1 unless it differs at ``level``, and the p-value.

        ``estimated`` counts the samples the stated covariance was estimated from (0: stated).
        """
        n, (q, p) = self.lines.n, self.lines.B.shape
        if n - q < FEWEST:
            return 1.0, 1.0
        on = float(np.sum(self.lines.B * (np.linalg.pinv(self.lines.G, rcond=1e-12, hermitian=True) @ self.lines.B)))
        return noise_compared(self.energy - on, (n - q) * p, estimated * p, level)


def noise_compared(found: float, freedom: float, estimated: float, level: float) -> tuple[float, float]:
    """Return an energy over its degrees of freedom, 1 unless it differs at ``level`` (two-sided), and the p-value.

    A variance estimated from ``estimated`` numbers widens the distribution: both errors count.
    """
    share, both = found / freedom, 1 + (freedom / estimated if estimated else 0.0)
    at = freedom / both * share  # chi-squared with fewer degrees of freedom has the relative spread of both
    p = min(1.0, 2 * min(float(chdtrc(freedom / both, max(at, 0.0))), float(chdtr(freedom / both, max(at, 0.0)))))
    return (share, p) if p < level else (1.0, p)


@njit(cache=True)
def energy(e, total):  # type: ignore[no-untyped-def]
    """Return a sum of squares continued, sample by sample in their order."""
    for t in range(e.shape[0]):
        for i in range(e.shape[1]):
            total += e[t, i] * e[t, i]
    return total
