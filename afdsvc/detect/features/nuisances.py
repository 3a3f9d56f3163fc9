"""Nuisances, removed from a residual recursively: drift, mains frequency, rotor-synchronous waves.

Unbalance and runout turn with the rotor: sines and cosines of multiples of its angle. Together with constant and slope and
with sines at mains frequency they span a space N; every series (residual, regressors, expected waves) is replaced by its recursive
residuals with respect to N,

    s*[t] = (s[t] - N[t] C[t-1]) / sqrt(1 + N[t] P[t-1] N[t]'),     P, C by recursive least squares from a diffuse start.

This is an orthonormal transformation that leaves N out: white noise stays white with unit covariance, exactly, and
``r = theta psi + d`` becomes ``r* = theta psi* + d*``, so least squares on the starred series is least squares on the
projected ones (R. L. Brown, J. Durbin and J. M. Evans, *J. R. Statist. Soc. B* 37, 1975). As many samples as N has
directions are spent on learning them. The cost per sample is constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from afdsvc.api.detection import ResidualBlock
from afdsvc.detect.features.demodulation import Basis
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array

DIFFUSE = 1e8  # prior variance of nuisance amplitudes, in variances of the noise
LEARNING = 1.0  # prediction variance above which a sample was spent on learning a nuisance


@dataclass(frozen=True, slots=True, eq=False)
class Cleaning:
    """Recursive least squares in progress: samples since the start, ``P (q, q)``, coefficients ``C (q, w)``."""

    n: int
    P: Array
    C: Array


@dataclass(frozen=True, slots=True)
class Nuisances:
    """What is taken out: constant and slope with ``drift``, ``mains`` frequencies [rad/s], ``orders`` of the rotor angle.

    The angle [rad] is the ``aux`` column labelled ``angle``. With ``if_recorded`` the orders are taken out when it is there;
    otherwise a missing angle is an error.
    """

    drift: bool = False
    mains: tuple[float, ...] = ()
    orders: tuple[int, ...] = ()
    if_recorded: bool = False
    angle: str = "angle"

    def turning(self, block: ResidualBlock) -> bool:
        """Whether orders are taken out of this block; raises `BadInput` when the rotor angle is required but missing."""
        if not self.orders or self.angle in block.aux:
            return bool(self.orders)
        if self.if_recorded:
            return False
        raise BadInput(f"the block has no aux '{self.angle}'; expected the rotor angle to remove its waves")

    def angles(self, block: ResidualBlock) -> Array | None:
        """Return the rotor angle ``(n,)`` [rad] of a block, None when no orders are taken out of it."""
        if not self.turning(block):
            return None
        return np.asarray(block.aux[self.angle], dtype=float).reshape(len(block), -1)[:, 0]

    def basis(self, omega: tuple[float, ...], turning: bool) -> Basis:
        """Return excited lines and nuisances as the functions a burst is regressed on."""
        return Basis(omega, self.drift, self.mains, self.orders if turning else ())

    def clean(
        self, state: Cleaning | None, block: ResidualBlock, series: Array, period: int = 0
    ) -> tuple[Cleaning | None, Array, NDArray[np.bool_]]:
        """Return the state after the block, the series ``(n, S, p)`` without nuisances, and which samples still tell.

        ``state`` None starts anew, as does every ``period`` samples when one is given: amplitudes may change slowly.
        """
        angle = self.angles(block)
        orders = np.array(self.orders if angle is not None else (), dtype=float)
        q = 2 * (self.drift + len(self.mains) + len(orders))
        if not q:
            return None, series, np.ones(len(series), dtype=bool)
        flat = np.ascontiguousarray(series.reshape(len(series), -1))
        if state is None or state.C.shape != (q, flat.shape[1]):
            state = Cleaning(0, DIFFUSE * np.eye(q), np.zeros((q, flat.shape[1])))
        P, C, out, v = state.P.copy(), state.C.copy(), np.empty_like(flat), np.empty(len(flat))
        turned = np.zeros(0) if angle is None else np.ascontiguousarray(angle)
        _clean(state.n, period, block.dt, self.drift, np.array(self.mains), orders, turned, flat, P, C, out, v)
        return Cleaning(state.n + len(flat), P, C), out.reshape(series.shape), v <= LEARNING


NONE = Nuisances()


@njit(cache=True)
def _clean(n, period, dt, drift, mains, orders, angle, s, P, C, out, v):  # type: ignore[no-untyped-def]
    q, w = C.shape
    phi, gain = np.zeros(q), np.zeros(q)
    for t in range(s.shape[0]):
        local = (n + t) % period if period else n + t
        if local == 0:
            _restart(P, C)
        _nuisances(local, dt, drift, mains, orders, angle, t, phi)
        v[t] = 0.0
        for i in range(q):
            gain[i] = 0.0
            for j in range(q):
                gain[i] += P[i, j] * phi[j]
            v[t] += phi[i] * gain[i]
        v[t] = max(v[t], 0.0)
        for j in range(w):
            e = s[t, j]
            for i in range(q):
                e -= phi[i] * C[i, j]
            out[t, j] = e / math.sqrt(1 + v[t])
            for i in range(q):
                C[i, j] += gain[i] * e / (1 + v[t])
        for i in range(q):
            for j in range(q):
                P[i, j] -= gain[i] * gain[j] / (1 + v[t])


@njit(cache=True)
def _restart(P, C):  # type: ignore[no-untyped-def]
    P[:], C[:] = 0.0, 0.0
    for i in range(P.shape[0]):
        P[i, i] = DIFFUSE


@njit(cache=True)
def _nuisances(local, dt, drift, mains, orders, angle, t, phi):  # type: ignore[no-untyped-def]
    c = 0
    if drift:
        phi[0], phi[1] = 1.0, 1e-3 * local
        c = 2
    for i in range(mains.size):
        phi[c], phi[c + 1] = math.sin(mains[i] * (local * dt)), math.cos(mains[i] * (local * dt))
        c += 2
    for i in range(orders.size):
        phi[c], phi[c + 1] = math.sin(orders[i] * angle[t]), math.cos(orders[i] * angle[t])
        c += 2
