"""Two detectors that know nothing of faults: the energy of the white residual, and its largest sample.

Both need no excitation; they are what a diagnosis has to beat. Their thresholds are exact for white residuals:
chi-squared with ``n p`` degrees of freedom, and the largest of ``n p`` independent normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import ndtri
from scipy.stats import chi2

from afdsvc.api.bursts import Burst
from afdsvc.detect.burst_detector import BurstSamples, Finding
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances


@dataclass(frozen=True, slots=True, eq=False)
class EnergySums:
    """Samples, sum of squares and largest absolute value of the normalised residual, nuisances learnt so far."""

    n: int
    energy: float
    largest: float
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True)
class Energy:
    """The statistic over a burst: chi-squared energy, or with ``peak`` the largest sample (a limit check), after the
    ``nuisances`` are projected out."""

    outputs: int
    false_alarm: float
    peak: bool
    nuisances: Nuisances = NONE

    def start(self, burst: Burst, dt: float) -> EnergySums:
        """Return empty sums."""
        return EnergySums(0, 0.0, 0.0)

    def step(self, sums: EnergySums, samples: BurstSamples) -> tuple[EnergySums, None]:
        """Return the sums with the samples added."""
        cleaning, clean, kept = self.nuisances.clean(sums.cleaning, samples.block, samples.series[:, :1])
        e = clean[kept, 0]
        energy, largest = _add(e, sums.energy, sums.largest)
        return EnergySums(sums.n + len(e), energy, largest, cleaning), None

    def decide(self, sums: EnergySums, burst: Burst, dt: float) -> Sequence[Finding]:
        """Return one finding without any fault in it."""
        count = sums.n * self.outputs
        if self.peak:
            each = -np.expm1(np.log1p(-self.false_alarm) / count)
            return [Finding(sums.largest, -float(ndtri(each / 2)))]
        return [Finding(sums.energy, float(chi2.isf(self.false_alarm, count)))]


@njit(cache=True)
def _add(e, energy, largest):  # type: ignore[no-untyped-def]
    for t in range(e.shape[0]):
        for i in range(e.shape[1]):
            energy += e[t, i] * e[t, i]
            largest = max(largest, abs(e[t, i]))
    return energy, largest
