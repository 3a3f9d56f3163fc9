"""Laws of the field trials that act as a force (per unit of mass) on an axis."""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws import field_codes as f
from afdsvc.trial.laws.codes import Row
from afdsvc.trial.laws.scalar import softplus


@numba.njit(cache=True, error_model="numpy")
def way(v: float, rounding: float) -> float:
    """Return the sign of v, rounded as v / sqrt(v^2 + rounding^2)."""
    return v / math.sqrt(v * v + rounding * rounding)


@numba.njit(cache=True, error_model="numpy")
def dry(v: float, p: Row) -> float:
    """Friction p0 forwards and p0 p2 backwards, sign rounded over p1."""
    return -p[0] * (1.0 if v > 0 else p[2]) * way(v, p[1])


@numba.njit(cache=True, error_model="numpy")
def stribeck(v: float, p: Row) -> float:
    """Friction p0, p2 times as much at rest, falling as exp(-|v / p3|^1.3); sign rounded over p1."""
    return -p[0] * (1.0 + (p[2] - 1.0) * math.exp(-(abs(v / p[3]) ** 1.3))) * way(v, p[1])


@numba.njit(cache=True, error_model="numpy")
def hard_spring(q: float, p: Row) -> float:
    """-p0 (sinh(q / p1) - q / p1)."""
    return -p[0] * (math.sinh(q / p[1]) - q / p[1])


@numba.njit(cache=True, error_model="numpy")
def leaning_spring(q: float, p: Row) -> float:
    """-p0 (exp(q / p1) - 1 - q / p1)."""
    return -p[0] * (math.expm1(q / p[1]) - q / p[1])


@numba.njit(cache=True, error_model="numpy")
def gap(q: float, p: Row) -> float:
    """Contact beyond p1 on both sides: -p0 d^1.3, onset rounded over p2."""
    return -math.copysign(p[0] * (p[2] * softplus((abs(q) - p[1]) / p[2])) ** 1.3, q)


@numba.njit(cache=True, error_model="numpy")
def ripple(q: float, p: Row) -> float:
    """Period 2 pi / p1 in the angle, phase p2, two further harmonics."""
    a = p[1] * q + p[2]
    return -p[0] * (math.sin(a) + 0.4 * math.sin(2.0 * a + 1.0) + 0.2 * math.sin(6.0 * a))


@numba.njit(cache=True, error_model="numpy")
def weight(q: float, p: Row) -> float:
    """What a lever's weight does beyond its linear part and its value at rest: angle q p1 from the attitude p2, a harmonic of 15 %."""
    a = q * p[1]
    return -p[0] * (math.sin(a + p[2]) - math.sin(p[2]) - a * math.cos(p[2]) + 0.15 * (math.sin(2.0 * a) - 2.0 * a))


@numba.njit(cache=True, error_model="numpy")
def _rubbing(code: int, q: float, v: float, load: float, p: Row) -> float:
    if code == f.DRY:
        return dry(v, p)
    if code == f.STRIBECK:
        return stribeck(v, p)
    if code == f.PRESSED:
        return -p[0] * (abs(load) + 0.1 * p[2]) * way(v, p[1])
    if code == f.PATCHY:
        return -p[0] * (1.0 + p[2] * math.sin(q / p[3] + p[4])) * way(v, p[1])
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _dragging(code: int, v: float, p: Row) -> float:
    if code == f.DRAG:
        return -p[0] * v * abs(v) * (1.0 + 0.1 * math.tanh(v / p[1]))
    if code == f.SLOW_DRAG:
        return -math.copysign(p[0] * abs(v) ** 1.5, v)
    if code == f.ONE_WAY:
        return -p[0] * 0.5 * v * (1.0 + way(v, p[1]))
    if code == f.EMF:
        return p[0] * (v - p[1] * math.tanh(v / p[1]))
    if code == f.SPEED_LIMIT:
        return -math.copysign(p[0] * p[2] * softplus((abs(v) - p[1]) / p[2]), v)
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _holding(code: int, q: float, t: float, p: Row) -> float:
    if code == f.HARDENING:
        return hard_spring(q, p)
    if code == f.LEANING:
        return leaning_spring(q, p)
    if code == f.GAP:
        return gap(q, p)
    if code == f.WEIGHT:
        return weight(q, p)
    if code == f.RIPPLE:
        return ripple(q, p)
    if code == f.LOAD:
        return p[0] * (1.0 + 0.02 * math.sin(t / p[1]))
    if code == f.TONE:
        return p[0] * (math.sin(p[1] * t + p[2]) + 0.2 * math.sin(2.0 * (p[1] * t + p[2])))
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _remembering(code, p, o, v, X, dX):  # type: ignore[no-untyped-def]
    if code == f.WARMING:  # friction p0 falls by p2 at most while |v| / p3, averaged over p4, keeps it warm
        dX[o] = (abs(v) / p[3] - X[o]) / p[4]
        return -p[0] * (1.0 - p[2] * X[o] / (1.0 + X[o])) * way(v, p[1])
    if code == f.BRISTLE:  # bristles of reach p1, p2 times stiffer at rest than beyond p3
        dX[o] = (v - abs(v) * X[o]) / p[1]
        return -p[0] * (X[o] * (1.0 + p[2] * math.exp(-((v / p[3]) ** 2))) + 0.1 * p[1] / p[3] * dX[o])
    if code == f.BOUC_WEN:  # width p1, exponent p2, skew p3
        turning = p[3] + (1.0 - p[3]) * math.copysign(1.0, v * X[o])
        dX[o] = v / p[1] * (1.0 - abs(X[o]) ** p[2] * turning)
        return -p[0] * X[o]
    if code == f.RIDER:  # a mass p0 on a spring of p1 rad/s, damping ratio p2; states: stretch and its own speed
        dX[o] = X[o + 1] - v
        dX[o + 1] = -p[1] * p[1] * X[o] - 2.0 * p[2] * p[1] * (X[o + 1] - v)
        return -p[0] * dX[o + 1]
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def force(law, axis, q, v, load, t, X, dX):  # type: ignore[no-untyped-def]
    """Return the sum of all forces on an axis at position q, speed v and driving force ``load``, at time t."""
    total = 0.0
    for e in range(law.shape[0]):
        code = int(law[e, f.CODE])
        if (code // f.GROUP == f.FORCE or code // f.GROUP == f.MORE_FORCE) and law[e, f.PLACE] == axis:
            p = law[e, f.VALUES :]
            total += _rubbing(code, q, v, load, p) + _dragging(code, v, p) + _holding(code, q, t, p)
            total += _remembering(code, p, int(law[e, f.OWN]), v, X, dX)
    return total
