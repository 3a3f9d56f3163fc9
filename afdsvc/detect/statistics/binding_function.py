"""Binding function of a regression: the severity it finds in the mean, as a function of the true one.

A regressor psi is minus the derivative of the prediction error e at severity 0. Where the error is not a straight line in the severity, the
regression converges to ``m(theta) = E psi'e / E psi'psi``, expectations in the loop with the fault: noise by its stationary covariance,
excited lines by their responses. The inverse of m takes the bias out.

Source: C. Gourieroux, A. Monfort, E. Renault, "Indirect inference", Journal of Applied Econometrics 8 (1993) S85-S118.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import Regressors, noise_sources, regressors
from afdsvc.detect.stability_range import reachable
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import AugmentedPlant, star
from afdsvc.lti.lyapunov import discrete_lyapunov
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace

GRID = 1024  # frequencies of a spectrum
STEPS = 8  # secant steps
CLOSE = 1e-4  # severity to which the inverse is found
NUDGE = 1e-3  # severity by which the slope is taken


@dataclass(frozen=True, slots=True, eq=False)
class BindingFunction:
    """m of one fault under a burst of lines."""

    problem: DetectionProblem
    fault: str
    burst: Burst

    def __call__(self, severity: float) -> float:
        """Return the severity that the regression finds in the mean; nan where the loop is lost."""
        p, loop = self.problem.plant.outputs, self._loop(severity)
        if not loop.is_stable():
            return float("nan")
        second = self._second(loop)
        return float(np.trace(second[p:, :p]) / np.trace(second[p:, p:]))

    def spread(self, severity: float) -> float:
        """Return the standard deviation of the severity found over that of white noise, ``(sum psi'psi)^-1/2``.

        It is that of ``sum psi'd / sum psi'psi`` with ``d = e - m psi``, both Gaussian around the waves of the lines.
        """
        p, loop = self.problem.plant.outputs, self._loop(severity)
        second = self._second(loop)
        turned = np.eye(2 * p)
        turned[:p, p:] = -np.eye(p) * np.trace(second[p:, :p]) / np.trace(second[p:, p:])
        H = turned @ frequency_response(loop, np.arange(GRID // 2 + 1) * (2 * np.pi / (GRID * loop.dt)))[:, : 2 * p, : self._sources]
        S = H @ np.swapaxes(H.conj(), -1, -2)
        products = S[:, p:, p:] * S[:, :p, :p].conj() + S[:, p:, :p] * S[:, :p, p:].conj()
        variance = float(np.mean(np.r_[products.real.sum(axis=(1, 2)), products[1:-1].real.sum(axis=(1, 2))]))
        played = 0.5 * float(np.mean(self.burst.envelope() ** 2))
        for wave, noise in self._waves(loop):
            d, at = np.roll(turned @ wave, p), turned @ noise
            variance += played * float(np.sum(np.abs(at.conj().T @ d) ** 2))
        return float(np.sqrt(variance / np.trace(second[p:, p:])))

    @property
    def _sources(self) -> int:
        return int(noise_sources(self.problem)[0].shape[1])

    def _loop(self, severity: float) -> StateSpace:
        return _loop(self.problem, self.fault, self.problem.augmented, {self.fault: severity})

    def _waves(self, loop: StateSpace) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return for every line the wave of ``[e, psi]`` and its responses to the noise there."""
        rows, q = slice(0, 2 * self.problem.plant.outputs), self._sources
        responses = frequency_response(loop, [line.omega for line in self.burst.lines])
        return [(line.amplitude * H[rows, q + line.input], H[rows, :q]) for line, H in zip(self.burst.lines, responses, strict=True)]

    def _second(self, loop: StateSpace) -> Array:
        """Return the mean of ``[e, psi] [e, psi]'``."""
        second = _of_noise(self.problem, loop)
        played = 0.5 * float(np.mean(self.burst.envelope() ** 2))
        return np.asarray(second + sum(played * np.outer(wave, wave.conj()).real for wave, _ in self._waves(loop)))

    def inverse(self, found: float) -> tuple[float, float] | None:
        """Return the severity under which ``found`` is the mean, and the slope of m there; None where there is none."""
        low, high = (0.999 * end for end in reachable(self.problem)[self.fault])
        before, theta, at = 0.0, min(max(found, low), high), 0.0
        for _ in range(STEPS if theta else 0):
            now = self(theta)
            slope = (now - at) / (theta - before)
            if not slope > 0:
                return None
            before, at, theta = theta, now, min(max(theta + (found - now) / slope, low), high)
            if abs(theta - before) < CLOSE:
                slope = (self(theta + NUDGE) - self(theta - NUDGE)) / (2 * NUDGE)
                return (theta, slope) if slope > 0 else None
        return None


def products_of_noise(problem: DetectionProblem, fault: str, augmented: AugmentedPlant, severities: Mapping[str, float]) -> tuple[float, float] | None:
    """Return the means of ``psi'e`` and ``psi'psi`` per sample, psi of one fault, in the loop that noise alone drives, its plant that of
    ``augmented`` with these severities; None where the loop is lost."""
    p, loop = problem.plant.outputs, _loop(problem, fault, augmented, severities)
    if not loop.is_stable():
        return None
    second = _of_noise(problem, loop)
    return float(np.trace(second[p:, :p])), float(np.trace(second[p:, p:]))


def _of_noise(problem: DetectionProblem, loop: StateSpace) -> Array:
    """Return the mean of ``[e, psi] [e, psi]'`` without a burst."""
    noise, rows = slice(0, len(noise_sources(problem)[0].T)), slice(0, 2 * problem.plant.outputs)
    P = discrete_lyapunov(loop.A, loop.B[:, noise] @ loop.B[:, noise].T)
    return np.asarray(loop.C[rows] @ P @ loop.C[rows].T + loop.D[rows, noise] @ loop.D[rows, noise].T)


def _loop(problem: DetectionProblem, fault: str, augmented: AugmentedPlant, severities: Mapping[str, float]) -> StateSpace:
    """Return the loop with these severities from ``[unit white noise, alpha]`` to ``[normalised e, normalised psi, ..]``."""
    s, k, (Bn, Dn), f = augmented.system, augmented.channels, noise_sources(problem), regressors(problem)
    (p, q), m = Dn.shape, problem.plant.inputs
    B = np.hstack([s.B[:, :k], Bn, s.B[:, k:]])
    D = np.hstack([s.D[:, :k], np.vstack([np.zeros((k, q)), Dn]), s.D[:, k:]])
    g = replace(augmented, system=StateSpace(s.A, B, s.C, D, s.dt)).close(severities)
    h, (out_y, out_u) = _filter(f, f.names.index(fault))
    u = np.hstack([np.zeros((m, q)), np.eye(m)])
    A = np.block([[g.A, np.zeros((g.order, h.order))], [h.B[:, :p] @ g.C, h.A]])
    into = np.vstack([g.B, h.B[:, :p] @ g.D + h.B[:, p:] @ u])
    C = np.block([[out_y @ g.C, h.C], [g.C, np.zeros((p, h.order))]])
    return star(StateSpace(A, into, C, np.vstack([out_y @ g.D + out_u @ u, g.D]), s.dt), problem.interconnection, p, m)


def _filter(f: Regressors, i: int) -> tuple[StateSpace, tuple[Array, Array]]:
    """Return the filter from ``[y, u]`` to ``[normalised e, normalised psi]`` of one fault, and its direct part by y and by u."""
    g, p = f.plant, f.plant.outputs
    A, zero = g.A - f.Kp @ g.C, np.zeros((p, p))
    Z, Zu = f.Bw[i] @ f.Cz[i] - f.Kd[i] @ g.C, f.Bw[i] @ f.Dzu[i] - f.Kd[i] @ g.D
    both = np.block([[A, np.zeros_like(A)], [Z, A]])
    into = np.block([[f.Kp, g.B - f.Kp @ g.D], [f.Kd[i], Zu]])
    C = np.block([[-f.Li @ g.C, np.zeros((p, g.order))], [f.Li @ f.Dyw[i] @ f.Cz[i], f.Li @ g.C]])
    out_y, out_u = np.vstack([f.Li, zero]), np.vstack([-f.Li @ g.D, f.Li @ f.Dyw[i] @ f.Dzu[i]])
    return StateSpace(both, into, C, np.hstack([out_y, out_u]), g.dt), (out_y, out_u)
