"""Laws of the field trials inside a process: characteristics that replace a linear one, further branches, sensors."""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws import field_codes as f
from afdsvc.trial.laws.codes import Row
from afdsvc.trial.laws.commands import uneven_limit
from afdsvc.trial.laws.scalar import softplus


@numba.njit(cache=True, error_model="numpy")
def root(x: float, p: Row) -> float:
    """Factor by which an outflow with the square root of the head differs from its slope at x = 0, head p0 there."""
    return 2.0 / (1.0 + math.sqrt(max(1.0 + x / p[0], 0.0)))


@numba.njit(cache=True, error_model="numpy")
def magnet(x: float, y: float, a: float, b: float, p: Row) -> float:
    """Pull with the square of current over gap, linear part a x + b y about the gap p0: x gap, y current."""
    reach = 1.0 + max(x / p[0], -0.9)
    return 0.5 * a * p[0] * (1.0 - ((1.0 - b * y / (a * p[0])) / reach) ** 2)


@numba.njit(cache=True, error_model="numpy")
def _bent(code: int, x: float, y: float, a: float, b: float, p: Row) -> float:
    linear = a * x + b * y
    if code == f.ROOT:
        return linear * root(x, p)
    if code == f.MAGNET:
        return magnet(x, y, a, b, p)
    if code == f.INDUCTANCE:
        z = (x / p[0]) ** 2
        return linear * (1.0 + z / (1.0 + 0.2 * z))
    if code == f.RADIATION:
        z = max(x / p[0], -1.0)
        return linear * (1.0 + 1.5 * z + z * z + 0.25 * z**3)
    if code == f.HARD_SHAFT:
        return linear + a * (p[0] * math.sinh(x / p[0]) - x)
    if code == f.LOOSE_SHAFT:
        return linear - a * p[0] * math.tanh(x / p[0])
    return linear


@numba.njit(cache=True, error_model="numpy")
def characteristic(law, place, x, y, a, b, X, dX):  # type: ignore[no-untyped-def]
    """Return what the process has in place of ``a x + b y`` at a place of the plant."""
    total = a * x + b * y
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if code // f.GROUP == f.CHARACTERISTIC and law[e, f.PLACE] == place:
            p, o = law[e, f.VALUES :], int(law[e, f.OWN])
            if code == f.HEATING:  # loss a x grows by p0 per unit of warmth, heated by (x / p1)^2 over p2 seconds
                dX[o] = ((x / p[1]) ** 2 - X[o]) / p[2]
                total += a * x * p[0] * X[o]
            else:
                total += _bent(code, x, y, a, b, p) - a * x - b * y
    return total


@numba.njit(cache=True, error_model="numpy")
def branch(law, place, x, X, dX):  # type: ignore[no-untyped-def]
    """Return what further branches take away from (negative) the quantity x per second at a place of the plant."""
    total = 0.0
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if code // f.GROUP == f.BRANCH and law[e, f.PLACE] == place:
            p, o = law[e, f.VALUES :], int(law[e, f.OWN])
            if code == f.SPILL:  # beyond the rim p1 (rounded over p2) it runs off at p0 per second
                total -= p[0] * p[2] * softplus((x - p[1]) / p[2])
            else:  # a further store exchanges at p0 per second and fills at p1 per second
                dX[o] = p[1] * (x - X[o])
                total -= p[0] * (x - X[o])
    return total


@numba.njit(cache=True, error_model="numpy")
def _sensed(code, p, o, y, other, t, X, dX):  # type: ignore[no-untyped-def]
    if code == f.TWO_POLES:
        dX[o], dX[o + 1] = (y - X[o]) / p[0], (X[o] - X[o + 1]) / (0.3 * p[0])
        return X[o + 1]
    if code == f.CLIPPED:
        return uneven_limit(y, p)
    if code == f.BENT:
        return y + p[0] * y * y / (p[1] * (1.0 + 0.2 * (y / p[1]) ** 2))
    if code == f.WARM_UP:
        return y + p[0] * (1.0 - math.exp(-t / p[1]))
    if code == f.CROSSED:
        return y + p[0] * other
    if code == f.ECCENTRIC:
        return y + p[0] * (math.sin(y / p[1] + p[2]) + 0.3 * math.sin(2.0 * y / p[1]))
    return y


@numba.njit(cache=True, error_model="numpy")
def sensed(law, i, y, other, t, X, dX):  # type: ignore[no-untyped-def]
    """Return what the sensor of output i makes of y; ``other`` is the next output, t the time since the run began."""
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if code // f.GROUP == f.SENSOR and law[e, f.PLACE] == i:
            y = _sensed(code, law[e, f.VALUES :], int(law[e, f.OWN]), y, other, t, X, dX)
    return y


@numba.njit(cache=True, error_model="numpy")
def readout(law, i, y):  # type: ignore[no-untyped-def]
    """Return the reading of output i after its noise: steps of p0."""
    for e in range(law.shape[0]):
        if law[e, f.CODE] == f.COARSE and law[e, f.PLACE] == i:
            y = law[e, f.VALUES] * math.floor(y / law[e, f.VALUES] + 0.5)
    return y
