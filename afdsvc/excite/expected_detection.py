"""Expected detection with a burst: deflections, separations, probabilities, standard errors.

All figures are those of the burst's steady part on its lines, the part that holds for every detector; what the loop's
own noise adds for the regression detector comes on top and is not counted on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.isolation import LineData, curve_fit
from afdsvc.detect.model_uncertainty import HealthyMachines, model_doubt, models
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import FaultCurves, fault_curves
from afdsvc.detect.statistics.line_tests import LargestProjection, LikelihoodRatio, LineTest
from afdsvc.detect.thresholds.power import tail
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedDetection:
    """The fault curves of a burst in standard deviations: ``R`` turns line coefficients into standard normal
    coordinates.
    """

    curves: FaultCurves
    R: Array
    reach: Mapping[str, tuple[float, float]]
    doubt: Array
    models: HealthyMachines | None = None
    severity_range: tuple[float, float] = (-1.0, 0.0)

    def wave(self, fault: str, severity: float) -> Array:
        """Return the point of a curve, shape ``(2 L, p)``; without doubt its length is the deflection."""
        return np.asarray(self.R @ self.curves.at(fault, [severity])[0])

    def data(self, z: Array) -> LineData:
        """Return the measurement z would be."""
        return LineData(z, self.R, self.doubt)

    def deflection(self, fault: str, severity: float) -> float:
        """Return how many standard deviations of the healthy machine the burst shows of this fault."""
        z = self.wave(fault, severity)
        return float(np.linalg.norm(self.data(z).whitened(np.eye(z.size), z)[0]))

    def threshold(self, false_alarm: float, severities: int = 8) -> float:
        """Return the threshold of the matched filter over all faults at so many severities."""
        low, high = self.severity_range
        return self._threshold(LargestProjection(tuple(np.linspace(high, low, severities + 1)[1:].tolist())), false_alarm)

    def ratio_threshold(self, false_alarm: float) -> float:
        """Return the threshold of the likelihood ratio along the curves of all faults."""
        return self._threshold(LikelihoodRatio(), false_alarm)

    def _threshold(self, test: LineTest, false_alarm: float) -> float:
        data = self.data(np.zeros((len(self.R), self.curves.Li.shape[0])))
        waves = test.waves(self.curves, data, self.reach)
        return test.threshold(waves, data, self.models, false_alarm) if len(waves) else float("inf")

    def detection(self, fault: str, severity: float, threshold: float) -> float:
        """Return the probability that a matched filter tuned to this wave exceeds the threshold.

        The faulty loop makes other noise than the healthy one, so the statistic's spread is not 1.
        """
        z, covariance = self.wave(fault, severity), self.curves.coloured(fault, [severity])[1][0]
        healthy = np.linalg.inv(np.linalg.cholesky(np.eye(z.size) + self.doubt))
        d = healthy @ z.ravel()
        length = float(np.linalg.norm(d))
        if not length > 0:
            return tail(threshold)
        e = healthy.T @ d / length
        return tail((threshold - length) / float(np.sqrt(e @ (covariance + self.doubt) @ e)))

    def deviation(self, fault: str, severity: float) -> float:
        """Return the Cramer-Rao standard error of the severity; inf when the burst cannot see the fault."""
        slope, covariance = self.R @ self.curves.slope(fault, severity), self.curves.coloured(fault, [severity])[1][0]
        length = float(np.linalg.norm(self.data(slope).whitened(covariance, slope)[0]))
        return 1 / length if length > 0 else float("inf")

    def separation(self, fault: str, severity: float, other: str) -> float:
        """Return the distance from one fault to the nearest point of another fault's curve, in standard deviations."""
        z, covariance = self.wave(fault, severity), self.curves.coloured(fault, [severity])[1][0]
        nearest = curve_fit(self.curves, other, self.data(z), self.reach[other])
        return float(np.linalg.norm(self.data(z).whitened(covariance, z - self.wave(other, nearest.severity))[0]))

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


def expected_detection(problem: DetectionProblem, lines: Sequence[Line], samples: int) -> ExpectedDetection:
    """Return the prospect of lines played steadily for ``samples`` samples (whole periods of distinct frequencies)."""
    R = np.sqrt(samples / 2) * np.eye(2 * len(lines))
    doubt, found = model_doubt(problem, lines, R), models(problem, lines, R) if problem.uncertainty else None
    return ExpectedDetection(fault_curves(problem, lines), R, reachable(problem), doubt, found, problem.severity_range)


def burst_detection(problem: DetectionProblem, burst: Burst) -> ExpectedDetection:
    """Return the prospect of a burst of lines: its samples between the ramps after settling."""
    return expected_detection(problem, sorted(burst.lines, key=lambda line: line.omega), steady_samples(burst))


def steady_samples(burst: Burst) -> int:
    """Return the number of samples between the ramps after settling."""
    return max(burst.samples - 2 * burst.ramp - burst.settle, 1)
