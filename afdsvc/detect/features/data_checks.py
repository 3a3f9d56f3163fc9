"""Is a burst fit to be judged: played as asked, complete, finite, no actuator at its limit, no sensor frozen?

The lines of the excitation must show in the measured input. The input u contains what was played, whatever is broken: an actuator that lost its gain still receives it, and a dead sensor
only opens the loop. A burst whose lines are much weaker in u than under the healthy machine and every fault was not played,
even when the recorded alpha says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, ResidualBlock
from afdsvc.detect.features.demodulation import BasisSums, window
from afdsvc.detect.features.nuisances import Nuisances
from afdsvc.detect.stability_range import reachable
from afdsvc.detect.statistics.fault_curves import loop_response
from afdsvc.lti.statespace import Array

SATURATED_SHARE = 0.01  # of a burst's samples spent exactly at one extreme, when no limit is stated
PLAYED = 1e-3  # energy of the difference between alpha played and asked, as a share of that asked


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Constant stretches of every output: last value, length so far ``(p,)``."""

    last: Array
    length: Array

    @classmethod
    def start(cls, outputs: int) -> Runs:
        """Return runs of nothing."""
        return cls(np.full(outputs, np.nan), np.zeros(outputs))

    def add(self, y: Array) -> tuple[Runs, Array]:
        """Return the runs after the samples ``y (n, p)`` and the longest run seen in them, shape ``(p,)``."""
        last, length, longest = self.last.copy(), self.length.copy(), np.zeros(y.shape[1])
        _runs(_rows(y), last, length, longest)
        return Runs(last, length), longest


@dataclass(frozen=True, slots=True, eq=False)
class BurstChecks:
    """What is counted during a burst; ``limit (m,)`` is the actuator limit, infinite where none is stated."""

    limit: Array
    n: int = 0
    bad: int = 0
    asked: float = 0.0
    played: float = 0.0
    difference: float = 0.0
    at_limit: Array | None = None
    extremes: Array | None = None
    longest: Array | None = None
    gap: bool = False

    def add(self, y: Array, u: Array, r: Array, alpha: Array, asked: Array, longest: Array) -> BurstChecks:
        """Return the counts with the samples added; ``asked`` is alpha as the burst defines it."""
        m = u.shape[1]
        at_limit = np.zeros(m) if self.at_limit is None else self.at_limit.copy()
        extremes = _no_extremes(m) if self.extremes is None else self.extremes.copy()
        energies = np.array([self.asked, self.played, self.difference])
        recorded = alpha if alpha.shape == asked.shape else np.zeros_like(asked)
        _count(_rows(u), _rows(recorded), _rows(asked), self.limit, at_limit, extremes, energies)
        usable = np.isfinite(y).all(axis=1) & np.isfinite(u).all(axis=1) & np.isfinite(r).all(axis=1)
        return replace(
            self, n=self.n + len(y), bad=self.bad + int(len(y) - usable.sum()), asked=float(energies[0]),
            played=float(energies[1]), difference=float(energies[2]), at_limit=at_limit, extremes=extremes,
            longest=longest if self.longest is None else np.maximum(self.longest, longest),
        )

    def complaint(self, samples: int, frozen: int, inputs: Sequence[str], outputs: Sequence[str]) -> str:
        """Return why the burst of ``samples`` samples must not be judged, in one sentence; "" when it may be."""
        if self.gap:
            return "samples are missing inside the burst, or Q came or went in it"
        if self.bad:
            return f"{self.bad} samples of the burst are not finite numbers"
        if self.n < samples:
            return f"the burst was ended after {self.n} of {samples} samples"
        return self._not_played() or self._saturated(inputs) or self._frozen(frozen, outputs)

    def _not_played(self) -> str:
        if self.asked > 0 and not self.played > 0:
            return "the excitation is absent: alpha was recorded as zero throughout the burst"
        if not self.difference <= PLAYED * self.asked:
            share = self.difference / self.asked if self.asked > 0 else np.inf
            return f"the recorded excitation differs from the requested one by {100 * share:.3g} % of its energy"
        return ""

    def _saturated(self, names: Sequence[str]) -> str:
        if self.at_limit is None or self.extremes is None:
            return ""
        for i, count in enumerate(self.at_limit):
            held = max(self.extremes[i, 1], self.extremes[i, 3])
            if count or held > max(3, SATURATED_SHARE * self.n):
                return f"actuator {_name(names, i)} was saturated for {int(max(count, held))} of {self.n} samples"
        return ""

    def _frozen(self, frozen: int, names: Sequence[str]) -> str:
        for i, run in enumerate(self.longest if self.longest is not None else ()):
            if run >= frozen:
                return f"sensor {_name(names, i)} was constant for {int(run)} samples"
        return ""


def _name(names: Sequence[str], i: int) -> str:
    return f"'{names[i]}'" if i < len(names) else f"number {i}"


def _no_extremes(m: int) -> Array:
    """Return for every input: lowest value, samples at it, highest value, samples at it."""
    return np.tile(np.array([np.inf, 0.0, -np.inf, 0.0]), (m, 1))


def _rows(a: Array) -> Array:
    return np.require(a, np.float64, ("C", "W"))


@njit(cache=True)
def _runs(y, last, length, longest):  # type: ignore[no-untyped-def]
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            length[i] = length[i] + 1.0 if y[k, i] == last[i] else 1.0
            last[i] = y[k, i]
            longest[i] = max(longest[i], length[i])


@njit(cache=True)
def _count(u, alpha, asked, limit, at_limit, extremes, energies):  # type: ignore[no-untyped-def]
    for k in range(u.shape[0]):
        for i in range(u.shape[1]):
            v = u[k, i]
            if abs(v) >= limit[i] * (1 - 1e-12):
                at_limit[i] += 1
            if v < extremes[i, 0]:
                extremes[i, 0], extremes[i, 1] = v, 0.0
            if v > extremes[i, 2]:
                extremes[i, 2], extremes[i, 3] = v, 0.0
            extremes[i, 1] += v == extremes[i, 0]
            extremes[i, 3] += v == extremes[i, 2]
        for i in range(asked.shape[1]):
            energies[0] += asked[k, i] ** 2
            energies[1] += alpha[k, i] ** 2
            energies[2] += (alpha[k, i] - asked[k, i]) ** 2


SEVERITIES = 16
WEAK = 0.25  # share of the weakest expected amplitude below which a line counts as absent
SURE = 6.0  # standard deviations of noise by which the weakest expected amplitude must stand out to be judged


@dataclass(frozen=True, slots=True, eq=False)
class PlayedLines:
    """The measured input on the excited lines during the steady part of a burst: sums, and its energy per input."""

    sums: BasisSums
    energy: Array

    @classmethod
    def start(cls, inputs: int) -> PlayedLines:
        """Return sums over nothing."""
        return cls(BasisSums(0, np.zeros((0, 0)), np.zeros((0, inputs))), np.zeros(inputs))

    def add(self, block: ResidualBlock, first: int, burst: Burst, nuisances: Nuisances) -> PlayedLines:
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
        """Return which line is missing from the measured input, in one sentence; "" when none is missing or it cannot be decided."""
        if not (self.sums.n and problem.loop_known):
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
                    f"expected at least {expected[k]:.3g}, whatever part has failed"
                )
        return ""


def weakest(problem: DetectionProblem, lines: tuple[Line, ...]) -> Array:
    """Return the smallest amplitude every line may cause at the inputs (all together), over health and every fault."""
    return problem.once(lambda: _weakest(problem, lines), "weakest lines", lines)


def _weakest(problem: DetectionProblem, lines: tuple[Line, ...]) -> Array:
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
