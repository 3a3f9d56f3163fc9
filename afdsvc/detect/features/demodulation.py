"""A burst reduced to a few numbers: least squares of the normalised residual on the excited lines.

While the samples of a burst stream by, only ``sum phi phi'`` and ``sum phi e'`` are kept, phi being sine and cosine
of every excited line followed by nuisance directions: constant and slope, mains frequency,
rotor-synchronous waves (from the rotor angle). What is left of the lines after those nuisances are projected out is

    z = R^-T (B_l - G_ln G_nn^-1 B_n),   R'R = G_ll - G_ln G_nn^-1 G_nl

whose entries are independent standard normals when nothing but noise came back, whatever the frequencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from afdsvc.api.bursts import Burst
from afdsvc.errors import BadInput, IllConditioned
from afdsvc.lti.statespace import Array, ComplexArray

_COLLINEAR = 1e-8  # share of a direction's energy that must survive the others


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The functions regressed on: excited ``omega`` [rad/s], then nuisances: ``mains`` frequencies [rad/s] and constant
    with slope when ``drift``; ``orders`` multiples of the rotor angle."""

    omega: tuple[float, ...]
    drift: bool = False
    mains: tuple[float, ...] = ()
    orders: tuple[int, ...] = ()

    @property
    def lines(self) -> int:
        """Number of columns of the excited lines."""
        return 2 * len(self.omega)

    @property
    def columns(self) -> int:
        """Number of all columns."""
        return self.lines + 2 * (self.drift + len(self.mains) + len(self.orders))


@dataclass(frozen=True, slots=True, eq=False)
class BasisSums:
    """``G (q, q)`` and ``B (q, p)`` over ``n`` samples."""

    n: int
    G: Array
    B: Array

    @classmethod
    def empty(cls, basis: Basis, outputs: int) -> BasisSums:
        """Return sums over nothing."""
        q = basis.columns
        return cls(0, np.zeros((q, q)), np.zeros((q, outputs)))

    def add(self, basis: Basis, first: int, dt: float, e: Array, angle: Array | None = None) -> BasisSums:
        """Return the sums with the normalised residual ``e (n, p)`` added; ``first`` counts samples since the burst
        began.

        ``angle (n,)`` is the rotor angle [rad], required when the basis has ``orders``.
        """
        G, B = self.G.copy(), self.B.copy()
        turned = np.zeros(0) if angle is None else np.ascontiguousarray(angle, dtype=float)
        _accumulate(
            np.array(basis.omega + basis.mains), len(basis.omega), basis.drift, np.array(basis.orders, dtype=float),
            turned, first, dt, np.ascontiguousarray(e), G, B,
        )
        return BasisSums(self.n + len(e), G, B)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The lines after projection: ``z (2 L, p)`` standard normal under noise, ``R (2 L, 2 L)`` so that a wave with line
    coefficients c ``(2 L, p)`` adds ``R c`` to z."""

    z: Array
    R: Array


def project(sums: BasisSums, basis: Basis) -> Lines:
    """Return the excited lines with the nuisances projected out; raises `IllConditioned` when nothing would be left."""
    k = basis.lines
    G, B = sums.G[:k, :k], sums.B[:k]
    if basis.columns > k:
        nuisance = np.linalg.pinv(sums.G[k:, k:], rcond=1e-12, hermitian=True) @ sums.G[k:, :k]
        G, B = G - sums.G[:k, k:] @ nuisance, B - nuisance.T @ sums.B[k:]
    left = np.linalg.eigvalsh(G / max(sums.n, 1))
    if not left[0] > _COLLINEAR:
        raise IllConditioned(
            f"an excited line coincides with another or with a nuisance: {max(left[0], 0) * 2:.2g} of its energy is "
            f"left, expected more than {2 * _COLLINEAR:.0e}"
        )
    R = np.asarray(np.linalg.cholesky(G)).T
    return Lines(np.asarray(np.linalg.solve(R.T, B)), R)


def line_frequencies(burst: Burst) -> tuple[float, ...]:
    """Return the frequencies [rad/s] of a burst's lines in order; raises `BadInput` for a burst that is not a sum of sines."""
    if not burst.lines or burst.waveform is not None:
        raise BadInput(f"burst '{burst.name}' is not a sum of sines; this detector needs one")
    omega = tuple(sorted({line.omega for line in burst.lines}))
    if len(omega) != len(burst.lines):
        raise BadInput(f"burst '{burst.name}' uses a frequency on two inputs; expected one for each input")
    return omega


def window(burst: Burst) -> tuple[int, int]:
    """Return the samples of a burst that are analysed: after ramp and settling, before the falling ramp."""
    return min(burst.ramp + burst.settle, burst.samples), max(burst.samples - burst.ramp, 0)


def coefficients(amplitudes: ComplexArray) -> Array:
    """Return line coefficients for complex amplitudes a (last axis p): ``Im(a e^{j w t})`` is ``Re a sin + Im a cos``.

    ``amplitudes`` has shape ``(..., L, p)``, the result ``(..., 2 L, p)`` in the order sin, cos of every line.
    """
    a = amplitudes
    return np.stack([a.real, a.imag], axis=-2).reshape(*a.shape[:-2], 2 * a.shape[-2], a.shape[-1])


@njit(cache=True)
def _accumulate(omega, lines, drift, orders, angle, first, dt, e, G, B):  # type: ignore[no-untyped-def]
    q, p = B.shape
    phi = np.zeros(q)
    for t in range(e.shape[0]):
        n = first + t
        c = 0
        for i in range(lines):
            phi[c], phi[c + 1] = math.sin(omega[i] * (n * dt)), math.cos(omega[i] * (n * dt))
            c += 2
        if drift:
            phi[c], phi[c + 1] = 1.0, n * dt
            c += 2
        for i in range(lines, omega.size):
            phi[c], phi[c + 1] = math.sin(omega[i] * (n * dt)), math.cos(omega[i] * (n * dt))
            c += 2
        for i in range(orders.size):
            phi[c], phi[c + 1] = math.sin(orders[i] * angle[t]), math.cos(orders[i] * angle[t])
            c += 2
        for i in range(q):
            for j in range(q):
                G[i, j] += phi[i] * phi[j]
            for j in range(p):
                B[i, j] += phi[i] * e[t, j]
