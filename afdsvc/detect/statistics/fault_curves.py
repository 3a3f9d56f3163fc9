"""Fault curves: the residual phasor of each excited line in the complex plane as a function of severity.

The curve of fault i is ``theta -> W^-1 S(theta e_i)(e^{jw}) a`` for excitation amplitudes a: one complex number per
line and output, zero at theta = 0. Loops are closed frequency by frequency (``u = K y + ..`` in positive feedback),
never by multiplying factor transfer functions. Source: thesis equations 2.19 and 5.6 (A. K. Sekunda, DTU 2017).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from afdsvc.api.bursts import Line
from afdsvc.api.detection import DetectionProblem
from afdsvc.api.memo import Memo
from afdsvc.detect.features.demodulation import coefficients
from afdsvc.detect.features.regressors import noise_sources, whitener
from afdsvc.errors import BadInput
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.lft import AugmentedPlant
from afdsvc.lti.statespace import Array, ComplexArray, StateSpace


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Responses from alpha at L frequencies and T severities: to y and r ``(T, L, p, m)``, to u ``(T, L, m, m)``.

    ``y`` is the plant output before measurement noise as the (possibly faulty) sensors report it. ``noise (T, L, p, q)`` leads from
    unit white noise to the normalised residual: a fault colours the loop's own noise.
    """

    y: ComplexArray
    u: ComplexArray
    r: ComplexArray
    noise: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """The loop at L frequencies, open where faults enter; `paths` closes it for any fault and severity.

    ``driven (L, channels + p, q)`` leads from unit white process and sensor noise to ``[z, y]``; None where sensor noise is all there
    is. ``Li`` normalises the residual.
    """

    augmented: AugmentedPlant
    plant: ComplexArray
    controller: ComplexArray
    residual: ComplexArray
    Li: Array
    driven: ComplexArray | None = None

    def paths(self, fault: str, severities: Sequence[float] | Array) -> Paths:
        """Return the responses under one fault at every severity."""
        own = self.augmented.channels_of(fault)
        return self._closed(np.asarray(severities, dtype=float)[:, None, None, None], range(own.start, own.stop))

    def together(self, severities: Mapping[str, float]) -> Paths:
        """Return the responses with several faults present at once (T = 1)."""
        return self._closed(self.augmented.severities(severities)[None, None, :, None], range(self.augmented.channels))

    def healthy(self) -> Paths:
        """Return the responses without a fault (T = 1)."""
        k = self.augmented.channels
        return self._close(self.plant[None, :, k:, k:], None if self.driven is None else self.driven[None, :, k:])

    def _closed(self, th: Array, own: range) -> Paths:
        """Return the responses for severities ``th (T, 1, 1 or channels, 1)`` of the channels ``own``."""
        k, channels = self.augmented.channels, slice(own.start, own.stop)
        inner = np.eye(len(own)) - th * self.plant[:, channels, channels]

        def with_faults(into: ComplexArray) -> ComplexArray:
            direct = th * np.broadcast_to(into[:, channels], (len(th), *into[:, channels].shape))
            return np.asarray(into[:, k:] + self.plant[:, k:, channels] @ np.linalg.solve(inner, direct), dtype=np.complex128)

        return self._close(with_faults(self.plant[:, :, k:]), None if self.driven is None else with_faults(self.driven))

    def _close(self, G: ComplexArray, disturbance: ComplexArray | None) -> Paths:
        p, m = G.shape[-2:]
        Kuy, Kua = self.controller[:, :m, :p], self.controller[:, :m, p:]
        loop, drive = np.eye(m) - Kuy @ G, np.broadcast_to(Kua, (*G.shape[:2], m, m))
        u = np.asarray(np.linalg.solve(loop, drive), dtype=np.complex128)
        y = np.asarray(G @ u, dtype=np.complex128)
        from_y, from_u = self.residual[:, :, :p], self.residual[:, :, p:]
        loop_y = np.eye(p) - G @ Kuy
        # Sensor noise alone is what the filter whitens, whatever the fault: then it is found from the healthy residual.
        noise = np.broadcast_to(np.linalg.inv(from_y), loop_y.shape) if disturbance is None else disturbance
        noise = self.Li @ ((from_y + from_u @ Kuy) @ np.linalg.solve(loop_y, noise))
        noise = noise @ np.linalg.inv(self.Li) if disturbance is None else noise
        return Paths(y, u, from_y @ y + from_u @ u, np.asarray(noise, dtype=np.complex128))


def loop_response(problem: DetectionProblem, omega: Sequence[float] | Array) -> LoopResponse:
    """Return the loop at the frequencies [rad/s]; raises `BadInput` where the controller is not known."""
    if not problem.loop_known:
        raise BadInput(
            f"machine '{problem.machine}' states no controller: what its loop makes of an excitation is not known; state [controller] "
            "in its model, or use the detector 'regression'"
        )

    def at(system: StateSpace) -> ComplexArray:
        return frequency_response(system, np.asarray(omega, dtype=float))

    controller, residual, driven = at(problem.interconnection), at(problem.innovations), None
    if problem.process_cov is not None and problem.process_cov.any():
        s, k, (Bn, Dn) = problem.augmented.system, problem.augmented.channels, noise_sources(problem)
        driven = at(StateSpace(s.A, Bn, s.C, np.vstack([np.zeros((k, Bn.shape[1])), Dn]), s.dt))
    return LoopResponse(problem.augmented, at(problem.augmented.system), controller, residual, whitener(problem.covariance), driven)


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
    memo: Memo = field(default_factory=Memo, repr=False)

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
        return _covariance(paths.noise @ np.swapaxes(paths.noise.conj(), -1, -2))

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
