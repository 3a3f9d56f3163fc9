"""Nonparametric frequency responses: the direct ratio, and why not to use it in closed loop.

With feedback the direct estimate ``S_yu S_uu^-1`` tends to the controller's inverse where noise dominates (thesis Eq
4.9; A. K. Sekunda, PhD thesis, DTU 2017, section 4.1). The indirect estimate through a signal that is free of the
noise, ``S_yr S_ur^-1``, does not.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, ComplexArray


def direct_spectral(recording: InputOutputData, segment: int) -> tuple[Array, ComplexArray]:
    """Return frequencies [rad/s] and ``S_yu S_uu^-1``, shape ``(k, p, m)``, by Welch averaging over ``segment``
    samples."""
    omega, Syu, Suu = _cross_spectra(recording.y, recording.u, recording.u, recording.dt, segment)
    return omega, _ratio(Syu, Suu)


def indirect_spectral(recording: InputOutputData, external: Array, segment: int) -> tuple[Array, ComplexArray]:
    """Return frequencies [rad/s] and ``S_yr S_ur^-1`` with an external signal ``r (N, m)`` free of the noise."""
    if external.shape != recording.u.shape:
        raise BadInput(f"external signal of shape {external.shape}; expected that of the input, {recording.u.shape},")
    both = np.hstack([recording.y, recording.u])
    omega, S, _ = _cross_spectra(both, external, external, recording.dt, segment)
    p = recording.y.shape[1]
    return omega, _ratio(S[:, :p], S[:, p:])


def _cross_spectra(a: Array, b: Array, c: Array, dt: float, segment: int) -> tuple[Array, ComplexArray, ComplexArray]:
    """Return frequencies, ``S_ab (k, na, nb)`` and ``S_bc``."""
    if len(a) < 4 * segment:
        raise BadInput(f"{len(a)} samples for segments of {segment}; expected at least {4 * segment}")

    def spectrum(x: Array, z: Array) -> tuple[Array, ComplexArray]:
        # scipy's csd conjugates its first argument
        f, P = signal.csd(z.T[None, :, :], x.T[:, None, :], fs=1 / dt, nperseg=segment, detrend="constant")
        return f, np.moveaxis(P, -1, 0)

    f, Sab = spectrum(a, b)
    return 2 * np.pi * f, Sab, spectrum(b, c)[1]


def _ratio(numerator: ComplexArray, denominator: ComplexArray) -> ComplexArray:
    return np.asarray(np.swapaxes(np.linalg.solve(np.swapaxes(denominator, 1, 2), np.swapaxes(numerator, 1, 2)), 1, 2))
