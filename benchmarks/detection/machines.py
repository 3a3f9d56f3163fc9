"""The machines, bursts and severities of the comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.testing.machines import bearing_problem, unstable_problem, with_rate

RATE = 0.01  # false alarms per burst at which powers are compared
LOOSE = Limits(np.full(1, 50.0), np.full(1, 50.0), np.full(1, 50.0))


@dataclass(frozen=True)
class Case:
    """One machine and controller, the burst it plays, the severities looked at."""

    key: str
    title: str
    problem: DetectionProblem
    burst: Burst
    severities: tuple[float, ...]
    isolation_severity: float
    amplitude_unit: str

    @property
    def exact(self) -> bool:
        """Whether the likelihood is that of the regression on psi at every severity (stable plant, output noise)."""
        return self.key != "unstable"

    def scaled(self, factor: float) -> Burst:
        """Return the burst with all amplitudes multiplied."""
        return replace(self.burst, lines=tuple(replace(line, amplitude=factor * line.amplitude) for line in self.burst.lines))


BEARING = (-0.02, -0.05, -0.1, -0.15, -0.2, -0.3, -0.5)
UNSTABLE = (-0.01, -0.02, -0.05, -0.1, -0.15, -0.2)
KEYS = ("lqg-0", "lqg-1100", "proportional-0", "proportional-1100", "unstable")


def case(key: str) -> Case:
    """Return one of the cases in `KEYS`: half a second of burst, 0.4 um or 1.5 units of output from every line."""
    if key == "unstable":
        problem = with_rate(unstable_problem(), RATE)
        burst = default_burst(problem, LOOSE, 0.6, 1.5)
        return Case(key, "unstable plant of P4, LQG", problem, burst, UNSTABLE, -0.15, "output units")
    controller, rpm = key.rsplit("-", 1)
    problem = with_rate(bearing_problem(controller, int(rpm)), RATE)
    burst = default_burst(problem, problem.limits or LOOSE, 0.5, 0.4)
    word = "LQG" if controller == "lqg" else "proportional"
    return Case(key, f"gas bearing, {word}, {rpm} rpm", problem, burst, BEARING, -0.5, "um")
