"""Fault curves: the residual phasor of each excited line in the complex plane as a function of severity.

The curve of fault i is ``theta -> W^-1 S(theta e_i)(e^{jw}) a`` for excitation amplitudes a: one complex number per
line and output, zero at theta = 0. Loops are closed frequency by frequency (``u = K y + ..`` in positive feedback),
never by multiplying factor transfer functions. Source: thesis equations 2.19 and 5.6 (A. K. Sekunda, DTU 2017).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.bursts import Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.demodulation import coefficients
from afdsvc.detect.features.regressors import whitener
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Responses from alpha at L frequencies and T severities: to y and r ``(T, L, p, m)``, to u ``(T, L, m, m)``.

    ``y`` is the plant output before measurement noise as the (possibly faulty) sensors report it. ``noise (T, L, p,
    p)`` leads from the residual of the healthy machine to that of the faulty one: a fault colours the loop's own
    noise.
    """

    y: ComplexArray
    u: ComplexArray
    r: ComplexArray
    noise: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """The loop at L frequencies, open where faults enter; `paths` closes it for any fault and severity."""

    augmented: AugmentedPlant
    plant: ComplexArray
    controller: ComplexArray
    residual: ComplexArray

    def paths(self, fault: str, severities: Sequence[float] | Array) -> Paths:
        """Return the responses under one fault at every severity."""
        s = np.asarray(severities, dtype=float)
        k, own = self.augmented.channels, self.augmented.channels_of(fault)
        Gzw, Gzu = self.plant[:, own, own], self.plant[:, own, k:]
        Gyw, Gyu = self.plant[:, k:, own], self.plant[:, k:, k:]
        th = s[:, None, None, None]
        direct = th * np.broadcast_to(Gzu, (len(s), *Gzu.shape))
        inner = np.linalg.solve(np.eye(own.stop - own.start) - th * Gzw, direct)
        return self._close(Gyu + Gyw @ inner)

    def together(self, severities: Mapping[str, float]) -> Paths:
        """Return the responses with several faults present at once (T = 1)."""
        k, th = self.augmented.channels, self.augmented.severities(severities)[:, None]
        inner = np.linalg.solve(np.eye(k) - th * self.plant[:, :k, :k], th * self.plant[:, :k, k:])
        return self._close((self.plant[:, k:, k:] + self.plant[:, k:, :k] @ inner)[None])

    def healthy(self) -> Paths:
        """Return the responses without a fault (T = 1)."""
        k = self.augmented.channels
        return self._close(self.plant[None, :, k:, k:])

    def _close(self, G: ComplexArray) -> Paths:
        p, m = G.shape[-2:]
        Kuy, Kua = self.controller[:, :m, :p], self.controller[:, :m, p:]
        loop, drive = np.eye(m) - Kuy @ G, np.broadcast_to(Kua, (*G.shape[:2], m, m))
        u = np.asarray(np.linalg.solve(loop, drive), dtype=np.complex128)
        y = np.asarray(G @ u, dtype=np.complex128)
        from_y, from_u = self.residual[:, :, :p], self.residual[:, :, p:]
        loop_y = np.eye(p) - G @ Kuy
        noise = (from_y + from_u @ Kuy) @ np.linalg.solve(loop_y, np.broadcast_to(np.linalg.inv(from_y), loop_y.shape))
        return Paths(y, u, from_y @ y + from_u @ u, np.asarray(noise, dtype=np.complex128))


def loop_response(problem: DetectionProblem, omega: Sequence[float] | Array) -> LoopResponse:
    """Return the loop at the frequencies [rad/s]."""
    def at(system: StateSpace) -> ComplexArray:
        return frequency_response(system, np.asarray(omega, dtype=float))

    controller, residual = at(problem.interconnection), at(problem.innovations)
    return LoopResponse(problem.augmented, at(problem.augmented.system), controller, residual)


@dataclass(frozen=True, slots=True, eq=False)
class FaultCurves:
    """Curves of all faults for given lines, as real coefficients of the normalised residual.

    ``at(fault, thetas)`` returns them with shape ``(T, 2 L, p)``: sine and cosine of every line.
    """

    response: LoopResponse
    names: tuple[str, ...]
    inputs: tuple[int, ...]
    drive: ComplexArray
    Li: Array

    def at(self, fault: str, severities: Sequence[float] | Array) -> Array:
        """Return the points of one curve."""
        return self._points(self.response.paths(fault, severities))

    def together(self, severities: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the point ``(2 L, p)`` where several faults are present at once, and the covariance of its noise."""
        paths = self.response.together(severities)
        return self._points(paths)[0], self._noise(paths)[0]

    def coloured(self, fault: str, severities: Sequence[float] | Array) -> tuple[Array, Array]:
        """Return the points of one curve and the covariance ``(T, D, D)`` of the noise that comes with each.

        ``D = 2 L p``; the covariance is that of standardised coordinates, the identity for the healthy machine.
        """
        paths = self.response.paths(fault, severities)
        return self._points(paths), self._noise(paths)

    def slope(self, fault: str, severity: float) -> Array:
        """Return the derivative of a curve by severity, shape ``(2 L, p)``."""
        h = 1e-4
        low, high = self.at(fault, [severity - h, severity + h])
        return np.asarray((high - low) / (2 * h))

    def _noise(self, paths: Paths) -> Array:
        T = self.Li @ paths.noise @ np.linalg.inv(self.Li)
        return _covariance(T @ np.swapaxes(T.conj(), -1, -2))

    def _points(self, paths: Paths) -> Array:
        picked = np.stack([paths.r[:, i, :, column] for i, column in enumerate(self.inputs)], axis=1)
        return coefficients((picked * self.drive[None, :, None]) @ self.Li.T)


def _covariance(spectrum: ComplexArray) -> Array:
    """Return the covariance of sines and cosines whose spectra ``(T, L, p, p)`` are flat around every line."""
    T, L, p, _ = spectrum.shape
    full = np.zeros((T, L, 2, p, L, 2, p))
    for k in range(L):
        full[:, k, 0, :, k, 0], full[:, k, 1, :, k, 1] = spectrum[:, k].real, spectrum[:, k].real
        full[:, k, 1, :, k, 0], full[:, k, 0, :, k, 1] = spectrum[:, k].imag, -spectrum[:, k].imag
    return full.reshape(T, 2 * L * p, 2 * L * p)


def fault_curves(problem: DetectionProblem, lines: Sequence[Line]) -> FaultCurves:
    """Return the curves for the lines of a burst (a line excites one input; each line has a frequency of its own)."""
    response = loop_response(problem, [line.omega for line in lines])
    drive = np.array([line.amplitude * np.exp(1j * line.phase) for line in lines])
    inputs = tuple(line.input for line in lines)
    return FaultCurves(response, problem.fault_names, inputs, drive, whitener(problem.covariance))
