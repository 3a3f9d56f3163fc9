"""Rates and outputs of the plants, with the laws that act in them; without laws each is exactly its nominal model.

``c`` are the plant's constants, ``v`` the commands after the laws on their held values, ``w`` disturbances of the rates (one per
state of the plant), ``t`` absolute time; states of the laws follow the plant's in ``X``.
"""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws.commands import flow
from afdsvc.trial.laws.forces import force
from afdsvc.trial.laws.processes import branch, characteristic

FIRST, SECOND, PENDULUM, TANKS, IMPOSED, TWO_MASS, LEVITATION, STORES, MODES = range(9)


@numba.njit(cache=True, error_model="numpy")
def _first(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Speed or current x' = -c1 x + c0 u, and the angle it turns: X = x, angle."""
    u = flow(law, 0, v[0], X[1], X, dX)
    dX[0] = characteristic(law, 0, X[0], u, -c[1], c[0], X, dX) + force(law, 0, X[1], X[0], c[0] * u, t, X, dX)
    dX[0] += branch(law, 0, X[0], X, dX) + w[0]
    dX[1] = X[0]


@numba.njit(cache=True, error_model="numpy")
def _second(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """q'' = c0 u - c1 q - c2 q': X = q, q'."""
    load = c[0] * flow(law, 0, v[0], X[0], X, dX) - c[1] * X[0]
    dX[0] = X[1]
    dX[1] = load - c[2] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _pendulum(c, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """q'' = -c0 sin q - c1 q': X = q, q'; no input."""
    load = -c[0] * math.sin(X[0])
    dX[0] = X[1]
    dX[1] = load - c[1] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _tanks(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """h1' = c0 u - c1 h1, h2' = c2 h1 - c3 h2 about an operating point; half of what the first spills meets the second."""
    u = flow(law, 0, v[0], 0.0, X, dX)
    out1 = characteristic(law, 0, X[0], 0.0, c[1], 0.0, X, dX)
    out2 = characteristic(law, 1, X[1], 0.0, c[3], 0.0, X, dX)
    spilt = branch(law, 0, X[0], X, dX)
    dX[0] = c[0] * u - out1 + spilt + w[0]
    dX[1] = c[2] / c[1] * out1 - 0.5 * spilt - out2 + branch(law, 1, X[1], X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _two_mass(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Motor and load on a shaft: X = motor speed, twist, load speed, motor angle."""
    u = flow(law, 0, v[0], X[3], X, dX)
    shaft = characteristic(law, 0, X[1], 0.0, c[2], 0.0, X, dX) + c[3] * (X[0] - X[2])
    dX[0] = c[0] * u - c[1] * X[0] - shaft + force(law, 0, X[3], X[0], c[0] * u, t, X, dX) + w[0]
    dX[1] = X[0] - X[2]
    dX[2] = c[4] * shaft - c[5] * X[2] + force(law, 1, X[3] - X[1], X[2], c[4] * shaft, t, X, dX) + w[2]
    dX[3] = X[0]


@numba.njit(cache=True, error_model="numpy")
def _levitation(c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """y'' = c0 y + c1 i - c2 y' about the operating point: X = y, y'."""
    i = flow(law, 0, v[0], X[0], X, dX)
    load = characteristic(law, 0, X[0], i, c[0], c[1], X, dX)
    dX[0] = X[1]
    dX[1] = load - c[2] * X[1] + force(law, 0, X[0], X[1], load, t, X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _stores(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """Two stores of heat over the surroundings: T1' = c0 u - c1 (T1 - T2), T2' = c2 (T1 - T2) - c3 T2."""
    u = flow(law, 0, v[0], 0.0, X, dX)
    dX[0] = c[0] * u - c[1] * (X[0] - X[1]) + branch(law, 0, X[0], X, dX) + w[0]
    dX[1] = c[2] * (X[0] - X[1]) - characteristic(law, 0, X[1], 0.0, c[3], 0.0, X, dX)
    dX[1] += branch(law, 1, X[1], X, dX) + w[1]


@numba.njit(cache=True, error_model="numpy")
def _modes(c, v, w, X, dX, law):  # type: ignore[no-untyped-def]
    """Two damped modes; constants of each: frequency, damping ratio, gain of its own command, gain of the other's."""
    first, second = flow(law, 0, v[0], X[0], X, dX), flow(law, 1, v[1], X[2], X, dX)
    for k in range(2):
        own, other = (first, second) if k == 0 else (second, first)
        o, g = 2 * k, 4 * k
        dX[o] = X[o + 1]
        dX[o + 1] = c[g] ** 2 * (c[g + 2] * own + c[g + 3] * other - X[o]) - 2.0 * c[g + 1] * c[g] * X[o + 1] + w[o + 1]


@numba.njit(cache=True, error_model="numpy")
def _imposed(c, v, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Return the force c0 v + c1 q that answers an imposed speed v, with the forces of all laws against it: X = q."""
    return c[0] * v[0] + c[1] * X[0] - force(law, 0, X[0], v[0], c[0] * v[0], t, X, dX)


@numba.njit(cache=True, error_model="numpy")
def rates(plant, c, v, w, t, X, dX, law):  # type: ignore[no-untyped-def]
    """Fill dX with the rates of the plant's states and of the laws'."""
    if plant == FIRST:
        _first(c, v, w, t, X, dX, law)
    elif plant == SECOND:
        _second(c, v, w, t, X, dX, law)
    elif plant == PENDULUM:
        _pendulum(c, w, t, X, dX, law)
    elif plant == TANKS:
        _tanks(c, v, w, X, dX, law)
    elif plant == IMPOSED:
        dX[0] = v[0]
    elif plant == TWO_MASS:
        _two_mass(c, v, w, t, X, dX, law)
    elif plant == LEVITATION:
        _levitation(c, v, w, t, X, dX, law)
    elif plant == STORES:
        _stores(c, v, w, X, dX, law)
    else:
        _modes(c, v, w, X, dX, law)


@numba.njit(cache=True, error_model="numpy")
def outputs(plant, c, v, t, X, dX, law, y):  # type: ignore[no-untyped-def]
    """Fill y with the plant's outputs before any sensor; for an imposed motion dX gets the rates of its laws."""
    if plant == IMPOSED:
        y[0] = _imposed(c, v, t, X, dX, law)
    elif plant == TANKS or plant == STORES:
        y[0] = X[1]
        if y.size > 1:
            y[1] = X[0]
    else:
        y[0] = X[0]
        if y.size > 1:
            y[1] = X[2]
