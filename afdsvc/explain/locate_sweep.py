"""Responses of the predictor to many small disturbances at once: what each would have added to the whitened residual."""

from __future__ import annotations

import numpy as np
from numba import njit

from afdsvc.explain.simulator import Simulator
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import Whitener


def responses(simulator: Simulator, theta: Array, columns: Array, states: Array, outputs: Array, whitener: Whitener | None) -> Array:
    """Return the change of the predicted outputs, whitened, shape ``(n, p, b)``, for disturbances ``columns (n, b)``.

    Disturbance b pushes the states along ``states (order, b)`` (per sample) and adds ``outputs (p, b)`` times itself to the
    outputs. The predictor corrects what it sees, as it does in the residual; first order in the disturbance.
    """
    s = simulator.nominal.steps(theta, 4 if simulator.ramped else 1)
    plant = simulator.nominal.at(theta)
    a = np.linalg.matrix_power(s.phi, s.nsub) - simulator.gain @ plant.C
    p = plant.outputs
    filtered = whitener or Whitener(np.zeros((0, p, p)), np.eye(p))
    out = np.zeros((len(columns), p, columns.shape[1]))
    arrays = (a, plant.C, simulator.gain, columns, states, outputs, filtered.a, np.linalg.inv(filtered.chol), out)
    _sweep(*(np.ascontiguousarray(x) for x in arrays[:-1]), out)  # type: ignore[call-arg]
    return out


def unwhitened(whitener: Whitener, w: Array) -> Array:
    """Return the residual ``(n, p)`` whose whitened form is ``w``: the inverse of the whitener."""
    out = np.ascontiguousarray(w @ whitener.chol.T)
    if whitener.order:
        _recolour(np.ascontiguousarray(whitener.a), out)
    return out


@njit(cache=True, nogil=True)
def _recolour(ar, e):  # type: ignore[no-untyped-def]
    N, p = e.shape
    for k in range(N):
        for lag in range(1, min(ar.shape[0], k) + 1):
            for i in range(p):
                for j in range(p):
                    e[k, i] += ar[lag - 1, i, j] * e[k - lag, j]


def push(simulator: Simulator, theta: Array) -> tuple[Array, Array]:
    """Return what one sample of a held input ``(order, m)`` and of a held rate of change ``(order, order)`` does to the states."""
    s = simulator.nominal.steps(theta, 4 if simulator.ramped else 1)
    by_input, by_rate = s.gam, s.gx
    for _ in range(s.nsub - 1):
        by_input, by_rate = s.phi @ by_input + s.gam, s.phi @ by_rate + s.gx
    return by_input, by_rate


@njit(cache=True, nogil=True, fastmath=True)
def _sweep(a, C, Kp, F, G, H, ar, inv, out):  # type: ignore[no-untyped-def]  # noqa: C901 - one compiled loop over samples
    N, nb = F.shape
    n, p, order = a.shape[0], C.shape[0], ar.shape[0]
    x, new = np.zeros((n, nb)), np.zeros((n, nb))
    past = np.zeros((order + 1, p, nb))
    e = np.zeros((p, nb))
    for k in range(N):
        slot = k % (order + 1)
        y = past[slot]
        for i in range(p):
            for b in range(nb):
                y[i, b] = H[i, b] * F[k, b]
            for j in range(n):
                c = C[i, j]
                if c != 0.0:
                    for b in range(nb):
                        y[i, b] += c * x[j, b]
        for i in range(n):
            for b in range(nb):
                new[i, b] = G[i, b] * F[k, b]
            for j in range(n):
                c = a[i, j]
                if c != 0.0:
                    for b in range(nb):
                        new[i, b] += c * x[j, b]
            for j in range(p):
                c = Kp[i, j]
                if c != 0.0:
                    for b in range(nb):
                        new[i, b] -= c * H[j, b] * F[k, b]
        x, new = new, x
        e[:] = y
        for lag in range(1, min(order, k) + 1):
            old = past[(k - lag) % (order + 1)]
            for i in range(p):
                for j in range(p):
                    c = ar[lag - 1, i, j]
                    for b in range(nb):
                        e[i, b] -= c * old[j, b]
        for i in range(p):
            for j in range(i + 1):
                c = inv[i, j]
                for b in range(nb):
                    out[k, i, b] += c * e[j, b]
