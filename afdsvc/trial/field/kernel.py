"""The compiled loop of the field trials: read, control, hold, integrate by Runge-Kutta 4 in fixed steps."""

from __future__ import annotations

import numba
import numpy as np

from afdsvc.trial.field.plants import IMPOSED, outputs, rates
from afdsvc.trial.laws.commands import held
from afdsvc.trial.laws.field_codes import MEMORY
from afdsvc.trial.laws.processes import readout, sensed

OPEN, CONTROLLED, RELAY = range(3)


@numba.njit(cache=True, error_model="numpy")
def _slopes(plant, c, v, w, t, since, X, dX, law, y):  # type: ignore[no-untyped-def]
    """Fill dX with all rates and y with what the sensors show."""
    dX[:] = 0.0
    rates(plant, c, v, w, t, X, dX, law)
    outputs(plant, c, v, t, X, dX, law, y)
    for i in range(y.size):
        y[i] = sensed(law, i, y[i], y[(i + 1) % y.size], since, X, dX)


@numba.njit(cache=True, error_model="numpy")
def _step(plant, c, v, w, t0, since, h, X, dX, law, y, place, mean):  # type: ignore[no-untyped-def]
    """Advance X over h seconds by the classical Runge-Kutta scheme."""
    mean[:] = 0.0
    ahead = 0.0
    for stage in range(4):
        for i in range(X.size):
            place[i] = X[i] + ahead * h * dX[i]
        _slopes(plant, c, v, w, t0 + since + ahead * h, since + ahead * h, place, dX, law, y)
        for i in range(X.size):
            mean[i] += dX[i] / (6.0 if stage == 0 or stage == 3 else 3.0)
        ahead = 0.5 if stage < 2 else 1.0
    for i in range(X.size):
        X[i] += h * mean[i]


@numba.njit(cache=True, error_model="numpy")
def _controlled(K, xk, y, ref, alpha, u):  # type: ignore[no-untyped-def]
    """Fill u with K (y - ref) + alpha and step the controller; K stacks ``[A B; C D]``."""
    n = xk.size
    e = np.concatenate((xk, y - ref))
    both = K @ e
    u[:] = both[n:] + alpha
    xk[:] = both[:n]


@numba.njit(cache=True, error_model="numpy")
def simulate(plant, c, law, x0, mode, K, order, alpha, ref, noise, push, aux, t0, dt, substeps):  # type: ignore[no-untyped-def]
    """Return readings y (n, p), commands u (n, m) and states x (n, all) at the sampling instants.

    ``mode`` OPEN: the command is ``alpha (n, m)``; CONTROLLED: ``K (y - ref) + alpha``; RELAY: ``|alpha|`` with the sign opposite
    to the first reading less ``ref``, changed when it passes ``K[0, 0]``. ``noise (n, p)`` is added to the readings before their resolution,
    ``push (n, states of the plant)`` to the rates; ``aux (n,)`` is an auxiliary signal.
    """
    n, m, h = alpha.shape[0], alpha.shape[1], dt / substeps
    X, dX, place, mean = x0.copy(), np.zeros(x0.size), np.zeros(x0.size), np.zeros(x0.size)
    memory, xk, sign = np.zeros((law.shape[0], MEMORY)), np.zeros(order), 1.0
    y, u, v = np.zeros(noise.shape[1]), np.zeros(m), np.zeros(m)
    out_y, out_u, out_x = np.zeros(noise.shape), np.zeros((n, m)), np.zeros((n, x0.size))
    for k in range(n):
        if plant == IMPOSED:  # the force answers the speed of this very sample
            v[:] = alpha[k]
        _slopes(plant, c, v, push[k], t0 + k * dt, k * dt, X, dX, law, y)
        for i in range(y.size):
            y[i] = readout(law, i, y[i] + noise[k, i])
        u[:] = alpha[k]
        if mode == CONTROLLED:
            _controlled(K, xk, y, ref[k], alpha[k], u)
        elif mode == RELAY:
            if abs(y[0] - ref[k, 0]) > K[0, 0]:
                sign = -1.0 if y[0] > ref[k, 0] else 1.0
            u *= sign
        out_y[k], out_u[k], out_x[k] = y, u, X
        for j in range(substeps):
            for i in range(m):
                v[i] = held(law, memory, i, u[i], aux[k], h)
            _step(plant, c, v, push[k], t0, (k + j / substeps) * dt, h, X, dX, law, y, place, mean)
    return out_y, out_u, out_x
