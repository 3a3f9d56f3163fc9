"""Matched filter over the fault hypotheses, as the thesis' section 5.3 with its set of phases made exact.

The burst is reduced to sine and cosine amplitudes per excited line and output (`demodulate`). Every fault at several
severities is one direction there; the statistic is the largest projection, its threshold that of the maximum over the
whole set (`maximum`), not of one template. The severity comes from the nearest point of the fault's curve.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstFinding, BurstSamples
from afdsvc.detect.combinations import paired_on_lines
from afdsvc.detect.features.demodulation import Basis, BasisSums, Lines, line_frequencies, project
from afdsvc.detect.features.demodulation import window as window
from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.detect.isolation import LineData, anything_log_evidence, curve_fit, limited, weights
from afdsvc.detect.model_uncertainty import model_doubt, models
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import FaultCurves, fault_curves
from afdsvc.detect.statistics.line_tests import LargestProjection, LikelihoodRatio, LineTest
from afdsvc.detect.thresholds.power import tail
from afdsvc.lti.statespace import Array


@dataclass(frozen=True, slots=True, eq=False)
class MatchedFilter:
    """Statistic of the matched filter. ``severities`` are those whose phases are in the set. With ``likelihood`` the largest
    likelihood ratio along the whole curves is compared instead of the largest projection. The others are those of
    `nuisances.Nuisances`, what is projected out of the burst.
    """

    problem: DetectionProblem
    severities: tuple[float, ...]
    drift: bool = False
    mains: tuple[float, ...] = ()
    orders: tuple[int, ...] = ()
    angle: str = "angle"
    likelihood: bool = False
    if_recorded: bool = False

    @property
    def line_test(self) -> LineTest:
        """How the lines are judged."""
        return LikelihoodRatio() if self.likelihood else LargestProjection(self.severities)

    @property
    def nuisances(self) -> Nuisances:
        """What is projected out."""
        return Nuisances(self.drift, self.mains, self.orders, self.if_recorded, self.angle)

    def basis(self, burst: Burst, turning: bool = True) -> Basis:
        """Return what a burst is regressed on, rotor-synchronous waves only of a machine that is ``turning``.

        Raises `BadInput` for a burst that is not a sum of sines.
        """
        return self.nuisances.basis(line_frequencies(burst), turning)

    def start(self, burst: Burst, dt: float) -> BasisSums:
        """Return empty sums."""
        return BasisSums.empty(self.basis(burst), self.problem.plant.outputs)

    def step(self, sums: BasisSums, samples: BurstSamples) -> tuple[BasisSums, None]:
        """Return the sums with those samples added that lie in the steady part of the burst."""
        burst = samples.block.burst
        assert burst is not None  # noqa: S101 - the frame hands over samples of bursts only
        first, last = window(burst)
        a, b = max(first - samples.first, 0), max(last - samples.first, 0)
        e = samples.series[a:b, 0]
        if not len(e):
            return sums, None
        angle = self.nuisances.angles(samples.block)
        basis = self.basis(burst, angle is not None)
        if not sums.n:
            sums = BasisSums.empty(basis, e.shape[1])
        return sums.add(basis, samples.first + a, samples.dt, e, None if angle is None else angle[a:b]), None

    def decide(self, sums: BasisSums, burst: Burst, dt: float) -> Sequence[BurstFinding]:
        """Return one finding for all lines and outputs together."""
        lines, curves, data = self._reduced(sums, burst)
        waves = self.line_test.waves(curves, data, reachable(self.problem))
        statistic, h = self._judged(waves, data, burst)
        if not h < math.inf:
            return [BurstFinding(statistic, h)]
        z, reach = data.whitened(np.eye(data.z.size), data.z)[0], reachable(self.problem)
        rows, heights = self.line_test.comparisons(waves, h)
        fits = tuple(curve_fit(curves, n, data, reach[n]) for n in curves.names)
        fits = tuple(limited(f, rows @ z - heights, rows @ data.white_waves(data.R @ curves.slope(f.fault, f.severity)[None])[0]) for f in fits)
        parts = {"samples": float(sums.n), "tests": self.problem.false_alarms.per_burst / tail(h), **_amplitudes(lines, _ordered(burst))}
        finding = BurstFinding(statistic, h, fits, weights(fits, anything_log_evidence(z)), parts)
        return [paired_on_lines(finding, curves, data, reach, sums.n) if statistic > h else finding]

    def test(self, sums: BasisSums, burst: Burst) -> tuple[float, float]:
        """Return statistic and threshold only."""
        _, curves, data = self._reduced(sums, burst)
        return self._judged(self.line_test.waves(curves, data, reachable(self.problem)), data, burst)

    def _reduced(self, sums: BasisSums, burst: Burst) -> tuple[Lines, FaultCurves, LineData]:
        basis = self.basis(burst)
        if len(sums.G) != basis.columns:
            basis = self.basis(burst, turning=False)
        lines, ordered = project(sums, basis), _ordered(burst)
        doubt = model_doubt(self.problem, ordered, lines.R)
        curves = self.problem.once(lambda: fault_curves(self.problem, ordered), "fault curves", ordered)
        return lines, curves, LineData(lines.z, lines.R, doubt)

    def _judged(self, looked_for: Array, data: LineData, burst: Burst) -> tuple[float, float]:
        """Return the statistic of these waves and its threshold; 0 and inf when the burst sees no fault."""
        if not len(looked_for):
            return 0.0, math.inf
        z = data.whitened(np.eye(data.z.size), data.z)[0]
        found = models(self.problem, _ordered(burst), data.R) if self.problem.uncertainty else None
        rate, test = self.problem.false_alarms.per_burst, self.line_test
        about = (looked_for.shape, looked_for.tobytes(), data.doubt.tobytes(), found, rate)
        h = self.problem.once(lambda: test.threshold(looked_for, data, found, rate), "line threshold", test, *about)
        return test.statistic(looked_for, z), h


def _ordered(burst: Burst) -> tuple[Line, ...]:
    return tuple(sorted(burst.lines, key=lambda line: line.omega))


def _amplitudes(lines: Lines, ordered: Sequence[Line]) -> dict[str, float]:
    """Return the amplitude found on every line and output, in standard deviations of the normalised residual."""
    c = np.linalg.solve(lines.R, lines.z)
    found = {}
    for k, line in enumerate(ordered):
        for i in range(c.shape[1]):
            found[f"amplitude.{line.omega:.6g}.{i}"] = float(np.hypot(c[2 * k, i], c[2 * k + 1, i]))
    return found
