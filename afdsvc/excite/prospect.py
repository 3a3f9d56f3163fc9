"""What a burst will tell before it is played: deflections, separations, probabilities, standard errors.

All figures are those of the burst's steady part on its lines, the part that holds for every detector; what the loop's
own noise adds for the regression detector comes on top and is not counted on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.curves import FaultCurves, fault_curves
from afdsvc.detect.hypotheses import curve_fit
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """The fault curves of a burst in standard deviations: ``R`` turns line coefficients into standard normal
    coordinates.
    """

    curves: FaultCurves
    R: Array
    bounds: tuple[float, float]

    def wave(self, fault: str, severity: float) -> Array:
        """Return the point of a curve, shape ``(2 L, p)``; its length is the deflection."""
        return np.asarray(self.R @ self.curves.at(fault, [severity])[0])

    def deflection(self, fault: str, severity: float) -> float:
        """Return how many standard deviations the burst shows of this fault."""
        return float(np.linalg.norm(self.wave(fault, severity)))

    def deviation(self, fault: str, severity: float) -> float:
        """Return the Cramer-Rao standard error of the severity; inf when the burst cannot see the fault."""
        whiten = self.curves.coloured(fault, [severity])[1]
        length = float(np.linalg.norm(whiten.apply((self.R @ self.curves.slope(fault, severity))[None])))
        return 1 / length if length > 0 else float("inf")

    def deviation_of_statistic(self, fault: str, severity: float, direction: Array) -> float:
        """Return the standard deviation of a matched filter's statistic ``<direction, z>`` while the fault is
        present.
        """
        factor = np.linalg.inv(self.curves.coloured(fault, [severity])[1].inverse[0])
        e = direction[0::2] + 1j * direction[1::2]
        return float(np.linalg.norm(np.einsum("lqp,lq->lp", factor.conj(), e)))

    def separation(self, fault: str, severity: float, other: str) -> float:
        """Return the distance from one fault to the nearest point of another fault's curve, in standard deviations."""
        z, whiten = self.wave(fault, severity), self.curves.coloured(fault, [severity])[1]
        nearest = curve_fit(self.curves, other, z, self.R, self.bounds)
        return float(np.linalg.norm(whiten.apply((z - self.wave(other, nearest.severity))[None])))

    def separations(self, severity: float) -> Array:
        """Return the separations of every fault (row) from every other (column), shape ``(K, K)``, inf on the
        diagonal.
        """
        names = self.curves.names
        table = np.full((len(names), len(names)), np.inf)
        for i, fault in enumerate(names):
            for j, other in enumerate(names):
                if i != j:
                    table[i, j] = self.separation(fault, severity, other)
        return table


def prospect(problem: DetectionProblem, lines: Sequence[Line], samples: int) -> Prospect:
    """Return the prospect of lines played steadily for ``samples`` samples (whole periods of distinct frequencies)."""
    R = np.sqrt(samples / 2) * np.eye(2 * len(lines))
    return Prospect(fault_curves(problem, lines), R, problem.severity_range)


def burst_prospect(problem: DetectionProblem, burst: Burst) -> Prospect:
    """Return the prospect of a burst of lines: its samples between the ramps after settling."""
    return prospect(problem, sorted(burst.lines, key=lambda line: line.omega), steady_samples(burst))


def steady_samples(burst: Burst) -> int:
    """Return the number of samples between the ramps after settling."""
    return max(burst.samples - 2 * burst.ramp - burst.settle, 1)
