"""The machines whose alarm rates are counted, each with a short burst: small-sample effects show there first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem, DetectorDesign
from afdsvc.detect.features.demodulation import Basis, BasisSums, window
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem, with_rate

RATES = (1e-1, 1e-2, 1e-3, 1e-4)
DESIGNS: dict[str, DetectorDesign] = {design.name: design for design in afdsvc_detectors()}
MACHINES: dict[str, tuple[str, Callable[[], DetectionProblem]]] = {
    "lqg-0": ("gas bearing, LQG, 0 rpm", lambda: bearing_problem("lqg", 0)),
    "lqg-1100": ("gas bearing, LQG, 1100 rpm", lambda: bearing_problem("lqg", 1100)),
    "proportional-0": ("gas bearing, proportional, 0 rpm", lambda: bearing_problem("proportional", 0)),
    "proportional-1100": ("gas bearing, proportional, 1100 rpm", lambda: bearing_problem("proportional", 1100)),
    "unstable": ("unstable plant of P4, LQG", unstable_problem),
    "random": ("random plant of order 4, LQ", random_problem),
}


@dataclass(frozen=True)
class RateCase:
    """One machine and the burst it plays; ``statistic`` is a shipped detector's at a promised rate per burst."""

    key: str
    title: str
    problem: DetectionProblem
    burst: Burst

    def statistic(self, name: str, rate: float) -> object:
        return DESIGNS[name].design(with_rate(self.problem, rate), {}).statistic  # type: ignore[attr-defined]

    @property
    def dt(self) -> float:
        return self.problem.plant.dt

    def line_sums(self) -> BasisSums:
        """Return the sums over the steady part of a burst from which nothing but zeros came back."""
        basis = Basis(tuple(sorted({line.omega for line in self.burst.lines})))
        first, last = window(self.burst)
        p = self.problem.plant.outputs
        return BasisSums.empty(basis, p).add(basis, first, self.dt, np.zeros((last - first, p)))


def rate_case(key: str) -> RateCase:
    """Return a machine with a burst of 2500 samples (600 where a sample lasts a millisecond)."""
    title, make = MACHINES[key]
    problem = make()
    return RateCase(key, title, problem, short_burst(problem))


def short_burst(problem: DetectionProblem, amplitude: float = 0.4) -> Burst:
    """Return half a second of burst with so many units of output from every line."""
    m, p = problem.plant.inputs, problem.plant.outputs
    limits = problem.limits or Limits(np.full(p, 50.0), np.full(m, 50.0), np.full(m, 50.0))
    loose = replace(limits, output=np.minimum(limits.output, 50.0))
    samples = 2500 if problem.plant.dt < 1e-3 else 600
    return default_burst(problem, loose, samples * problem.plant.dt, amplitude)
