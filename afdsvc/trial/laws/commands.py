"""Laws of the field trials on a command: on its held value once per integration step, and inside the plant with own states."""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws import field_codes as f
from afdsvc.trial.laws.codes import Row
from afdsvc.trial.laws.memory import delayed

PLAY_COUNT = 6


@numba.njit(cache=True, error_model="numpy")
def uneven_zone(u: float, p: Row) -> float:
    """Dead zone of p0 upwards and p0 p1 downwards, hyperbolic corners of size p2."""
    w = p[0] if u > 0 else p[0] * p[1]
    z = abs(u) - w
    return 0.5 * math.copysign(z + math.sqrt(z * z + p[2] * p[2]) + w - math.sqrt(w * w + p[2] * p[2]), u)


@numba.njit(cache=True, error_model="numpy")
def sticky_zone(u: float, p: Row, m: Row, h: float) -> float:
    """Nothing passes until |u| exceeds p0; all of it does until |u| falls below p0 p1; the change takes p2 seconds."""
    if abs(u) > p[0]:
        m[0] = 1.0
    elif abs(u) < p[0] * p[1]:
        m[0] = 0.0
    m[1] += (m[0] - m[1]) * min(1.0, h / p[2])
    return u * m[1]


@numba.njit(cache=True, error_model="numpy")
def uneven_limit(u: float, p: Row) -> float:
    """Limit p0 upwards and p0 p1 downwards, approached as u / (1 + |u / limit|^p2)^(1 / p2)."""
    limit = p[0] if u > 0 else p[0] * p[1]
    return float(u / (1.0 + abs(u / limit) ** p[2]) ** (1.0 / p[2]))


@numba.njit(cache=True, error_model="numpy")
def plays(u: float, p: Row, m: Row) -> float:
    """Six plays of half widths up to p1, weights falling as exp(-j / 2); share p0 of the command goes through them."""
    total, weight = 0.0, 0.0
    for j in range(PLAY_COUNT):
        w = p[1] * (j + 1) / PLAY_COUNT
        m[j] = min(max(m[j], u - w), u + w)
        total += math.exp(-0.5 * j) * m[j]
        weight += math.exp(-0.5 * j)
    return u - p[0] * (u - total / weight)


@numba.njit(cache=True, error_model="numpy")
def soft_play(u: float, p: Row, m: Row) -> float:
    """Play of half width p0 whose flanks give way by p1 of the remaining path."""
    m[0] = min(max(m[0], u - p[0]), u + p[0])
    return m[0] + p[1] * (u - m[0])


@numba.njit(cache=True, error_model="numpy")
def soft_slew(u: float, p: Row, m: Row, h: float) -> float:
    """Follows u at a rate of at most p0, as p0 tanh(distance / (p0 p1))."""
    m[0] += h * p[0] * math.tanh((u - m[0]) / (p[0] * p[1]))
    return m[0]


@numba.njit(cache=True, error_model="numpy")
def _shaped(code: int, u: float, p: Row, aux: float) -> float:
    if code == f.UNEVEN_ZONE:
        return uneven_zone(u, p)
    if code == f.POWER_CURVE:
        return math.copysign(p[1] * (abs(u) / p[1]) ** (1.0 + p[0]), u)
    if code == f.UNEVEN_LIMIT:
        return uneven_limit(u, p)
    if code == f.GRID:
        return p[0] * math.floor(u / p[0] + 0.5)
    if code == f.LAME:
        return u + p[0] * (math.sqrt(u * u + p[1] * p[1]) - p[1])
    if code == f.FOLLOWS:
        d = (aux - p[1]) / p[2]
        return u * (1.0 + p[0] * (d + 0.2 * d * d))
    return u


@numba.njit(cache=True, error_model="numpy")
def _remembered(code: int, u: float, p: Row, m: Row, h: float) -> float:
    if code == f.STICKY_ZONE:
        return sticky_zone(u, p, m, h)
    if code == f.PLAYS:
        return plays(u, p, m)
    if code == f.SOFT_PLAY:
        return soft_play(u, p, m)
    if code == f.LATE:
        return delayed(u, m, p[0] / h, True)
    if code == f.SOFT_SLEW:
        return soft_slew(u, p, m, h)
    return u


@numba.njit(cache=True, error_model="numpy")
def held(law, m, i, u, aux, h):  # type: ignore[no-untyped-def]
    """Return command i after every law on its held value, in order; called once per integration step of h seconds."""
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if code // f.GROUP == f.HELD and law[e, f.PLACE] == i:
            p = law[e, f.VALUES :]
            u = _remembered(code, _shaped(code, u, p, aux), p, m[e], h)
    return u


@numba.njit(cache=True, error_model="numpy")
def _flowing(code, p, o, u, q, X, dX):  # type: ignore[no-untyped-def]
    if code == f.TWO_LAGS:
        dX[o], dX[o + 1] = (u - X[o]) / p[0], (X[o] - X[o + 1]) / p[0]
        return X[o + 1]
    if code == f.RINGING:
        dX[o], dX[o + 1] = X[o + 1], p[0] * p[0] * (u - X[o]) - 2.0 * p[1] * p[0] * X[o + 1]
        return X[o] + 0.1 * p[1] / p[0] * X[o + 1]
    if code == f.DROOP:
        dX[o] = (abs(u) / p[1] - X[o]) / p[2]
        return u * (1.0 - p[0] * X[o] / (1.0 + 0.3 * X[o]))
    if code == f.RELAXING:
        for j in range(3):
            dX[o + j] = (u - X[o + j]) / (p[1] * 4.0**j)
        return u + p[0] * (X[o] + 0.8 * X[o + 1] + 0.6 * X[o + 2]) / 2.4
    if code == f.PATCHY_GAIN:
        return u * (1.0 + p[0] * math.sin(q / p[1] + p[2]))
    return u


@numba.njit(cache=True, error_model="numpy")
def flow(law, i, u, q, X, dX):  # type: ignore[no-untyped-def]
    """Return command i after every law inside the plant; q is the position its actuator is at, own states are in X."""
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if code // f.GROUP == f.FLOW and law[e, f.PLACE] == i:
            u = _flowing(code, law[e, f.VALUES :], int(law[e, f.OWN]), u, q, X, dX)
    return u
