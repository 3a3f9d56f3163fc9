"""The thesis' matched filter as published, for comparison.

For each output the line that shows most there is correlated with unit sines at the phases of the faults of one design
severity; the best phase names the fault, ``T = sum r A sin(w n + phi)`` is compared with ``gamma = sqrt(sigma^2 N A^2
/ 2) Q^-1(P_FA)``, the threshold of a single template. With ``A = A_0`` (one amplitude for all) or ``A = A_phi`` (that
of the phase found) the numbers differ but A cancels between T and gamma: both are one test. Its true false-alarm rate
is that of the largest of all phases on all outputs, several times P_FA.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017, eqs.
5.19-5.30, publication P4 eqs. 27-46. The excitation enters with unit amplitude (A contains its size).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.burst_detector import BurstSamples, Finding
from afdsvc.detect.features.demodulation import Basis, BasisSums
from afdsvc.detect.features.nuisances import NONE, Cleaning, Nuisances
from afdsvc.detect.isolation import Fit
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.detect.statistics.matched_filter import window
from afdsvc.detect.thresholds.power import tail_point
from afdsvc.errors import BadInput, Refused
from afdsvc.lti.statespace import ComplexArray

UNSEEN = 1e-9  # an amplitude below this share of the largest belongs to no phase


@dataclass(frozen=True, slots=True, eq=False)
class PublishedSums:
    """Sums over the steady part of a burst, and nuisances learnt so far."""

    lines: BasisSums
    cleaning: Cleaning | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PublishedFilter:
    """The statistic; ``follow_phase`` chooses A_phi instead of A_0, ``severity`` is that of the design. ``nuisances``, which
    were not published, are projected out of the residual first.

    Raises `BadInput` for a severity at which the loop is lost: its published phases belong to no signal.
    """

    problem: DetectionProblem
    follow_phase: bool
    severity: float = -0.1
    nuisances: Nuisances = NONE

    def __post_init__(self) -> None:
        for name, (low, high) in reachable(self.problem).items():
            if not low <= self.severity <= high:
                raise BadInput(
                    f"severity {self.severity:g} of fault '{name}' makes the loop unstable; expected one from {low:.3g} to {high:.3g}"
                )

    def start(self, burst: Burst, dt: float) -> PublishedSums:
        """Return empty sums."""
        return PublishedSums(BasisSums.empty(_basis(burst), self.problem.plant.outputs))

    def step(self, sums: PublishedSums, samples: BurstSamples) -> tuple[PublishedSums, None]:
        """Return the sums with the steady samples added; the residual is taken output by output, not jointly
        whitened.
        """
        burst = samples.block.burst
        assert burst is not None  # noqa: S101 - the frame hands over samples of bursts only
        first, last = window(burst)
        a, b = max(first - samples.first, 0), max(last - samples.first, 0)
        cleaning, clean, _ = self.nuisances.clean(sums.cleaning, samples.block, samples.block.r[:, None])
        r = clean[a:b, 0]
        lines = sums.lines.add(_basis(burst), samples.first + a, samples.dt, r) if len(r) else sums.lines
        return PublishedSums(lines, cleaning), None

    def decide(self, sums: PublishedSums, burst: Burst, dt: float) -> Sequence[Finding]:
        """Return one finding for every output; raises `Refused` for a burst without a steady sample."""
        if not sums.lines.n:
            raise Refused(
                f"burst '{burst.name}' of {burst.samples} samples is all ramp and settling; expected a steady part for the "
                "published statistic"
            )
        waves = self._amplitudes(burst)
        return [self._output(sums.lines, waves, i) for i in range(self.problem.plant.outputs)]

    def _amplitudes(self, burst: Burst) -> ComplexArray:
        """Return complex amplitudes ``(K, L, p)`` of the residual for the design severity."""
        ordered = sorted(burst.lines, key=lambda line: line.omega)
        response = loop_response(self.problem, [line.omega for line in ordered])
        drive = np.array([line.amplitude * np.exp(1j * line.phase) for line in ordered])
        waves = []
        for name in self.problem.fault_names:
            r = response.paths(name, [self.severity]).r[0]
            waves.append(np.stack([r[k, :, line.input] * drive[k] for k, line in enumerate(ordered)]))
        return np.array(waves)

    def _output(self, sums: BasisSums, waves: ComplexArray, i: int) -> Finding:
        k = int(np.argmax(np.abs(waves[:, :, i]).max(axis=0)))
        a = waves[:, k, i]
        seen = np.flatnonzero(np.abs(a) > UNSEEN * np.abs(waves).max())
        name = self.problem.output_names[i] if i < len(self.problem.output_names) else str(i)
        if not len(seen):
            return Finding(0.0, float("inf"), output=name)
        sine, cosine = sums.B[2 * k, i], sums.B[2 * k + 1, i]
        unit = np.array([np.real(np.exp(-1j * np.angle(v)) * (sine + 1j * cosine)) for v in a[seen]])
        found = int(np.argmax(unit))
        A = abs(a[seen[found]]) if self.follow_phase else float(np.abs(a[seen]).max())
        sigma = float(np.sqrt(self.problem.covariance[i, i]))
        gamma = sigma * A * np.sqrt(sums.n / 2) * tail_point(self.problem.false_alarms.per_burst)
        fits = tuple(self._fit(int(j), a, float(u), sums.n, sigma) for j, u in zip(seen, unit, strict=True))
        chosen = self.problem.fault_names[seen[found]]
        weights = {f.fault: float(f.fault == chosen) for f in fits}
        parts = {"amplitude": 2 * float(unit[found]) / sums.n, "phase_deg": float(np.degrees(np.angle(a[seen[found]])) % 360)}
        return Finding(A * float(unit[found]), float(gamma), fits, weights, parts, name)

    def _fit(self, j: int, a: ComplexArray, unit: float, n: int, sigma: float) -> Fit:
        """Return the severity read off the amplitude in proportion to that of the design."""
        per = self.severity / float(abs(a[j]))
        value, sd = 2 * unit / n * per, sigma * float(np.sqrt(2 / n)) * abs(float(per))
        likelihood = unit**2 / (n * sigma**2)
        return Fit(self.problem.fault_names[j], float(np.clip(value, -1.0, 0.0)), sd, likelihood, likelihood)


def _basis(burst: Burst) -> Basis:
    return Basis(tuple(sorted({line.omega for line in burst.lines})))
