"""Did the excitation really reach the machine? Its lines must show in the measured input.

The input u contains what was played, whatever is broken: an actuator that lost its gain still receives it, and a dead sensor
only opens the loop. A burst whose lines are much weaker in u than under the healthy machine and every fault was not played,
even when the recorded alpha says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.curves import loop_response
from afdsvc.detect.demodulate import BasisSums, window
from afdsvc.detect.nuisances import Nuisances
from afdsvc.detect.reach import reachable
from afdsvc.lti.statespace import Array

SEVERITIES = 16
WEAK = 0.25  # share of the weakest expected amplitude below which a line counts as absent
SURE = 6.0  # standard deviations of noise by which the weakest expected amplitude must stand out to be judged


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The measured input on the excited lines during the steady part of a burst: sums, and its energy per input."""

    sums: BasisSums
    energy: Array

    @classmethod
    def start(cls, inputs: int) -> Shown:
        """Return sums over nothing."""
        return cls(BasisSums(0, np.zeros((0, 0)), np.zeros((0, inputs))), np.zeros(inputs))

    def add(self, block: ResidualBlock, first: int, burst: Burst, nuisances: Nuisances) -> Shown:
        """Return the sums with the samples of the block added; ``first`` counts from the beginning of the burst."""
        begin, end = window(burst)
        a, b = max(begin - first, 0), max(end - first, 0)
        u = block.u[a:b]
        if not burst.lines or not len(u):
            return self
        angle = nuisances.angles(block)
        basis = nuisances.basis(omegas(burst), angle is not None)
        sums = self.sums if self.sums.n else BasisSums.empty(basis, u.shape[1])
        sums = sums.add(basis, first + a, block.dt, u, None if angle is None else angle[a:b])
        return replace(self, sums=sums, energy=self.energy + np.sum(u**2, axis=0))

    def complaint(self, problem: DetectionProblem, burst: Burst) -> str:
        """Return which line is missing from the measured input, in one sentence; "" when none is or nobody can tell."""
        if not self.sums.n:
            return ""
        omega = omegas(burst)
        found = np.linalg.pinv(self.sums.G, rcond=1e-12, hermitian=True) @ self.sums.B
        left = np.maximum(self.energy - np.sum(found * self.sums.B, axis=0), 0.0)
        noise = np.sqrt(2 * left.sum()) / self.sums.n  # of an amplitude over all inputs
        expected = weakest(problem, tuple(sorted(burst.lines, key=lambda line: line.omega)))
        for k, w in enumerate(omega):
            amplitude = float(np.linalg.norm(found[2 * k : 2 * k + 2]))
            if expected[k] > SURE * noise and amplitude < WEAK * expected[k]:
                return (
                    f"the excitation is absent from the data: the input shows an amplitude of {amplitude:.3g} at {w:.5g} rad/s, "
                    f"at least {expected[k]:.3g} is wanted whatever is broken"
                )
        return ""


@lru_cache(maxsize=1024)  # keyed by identity of the problem: the same lines are played again and again
def weakest(problem: DetectionProblem, lines: tuple[Line, ...]) -> Array:
    """Return the smallest amplitude every line may cause at the inputs (all together), over health and every fault."""
    omega = sorted({line.omega for line in lines})
    response, reach = loop_response(problem, omega), reachable(problem)
    paths = [response.healthy().u]
    paths += [response.paths(name, np.linspace(high, low, SEVERITIES + 1)).u for name, (low, high) in reach.items()]
    smallest = np.full(len(omega), np.inf)
    for u in paths:
        driven = np.zeros(u.shape[:3], dtype=complex)
        for line in lines:
            k = omega.index(line.omega)
            driven[:, k] += line.amplitude * np.exp(1j * line.phase) * u[:, k, :, line.input]
        smallest = np.minimum(smallest, np.linalg.norm(driven, axis=2).min(axis=0))
    return smallest


def omegas(burst: Burst) -> tuple[float, ...]:
    """Return the distinct frequencies of a burst, ascending."""
    return tuple(sorted({line.omega for line in burst.lines}))
