"""Laws without memory: what a number becomes. Every one is smooth, or uses an exponent, that a textbook law has not."""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws.codes import Row


@numba.njit(cache=True, error_model="numpy")
def softplus(z: float) -> float:
    """Return log(1 + e^z) without overflow: a ramp with a rounded corner of width 1."""
    return z + math.log1p(math.exp(-z)) if z > 0 else math.log1p(math.exp(z))


@numba.njit(cache=True, error_model="numpy")
def dead_zone(u: float, p: Row) -> float:
    """Width p0 on either side of zero, corners rounded over p1."""
    return p[1] * (softplus((u - p[0]) / p[1]) - softplus((-u - p[0]) / p[1]))


@numba.njit(cache=True, error_model="numpy")
def saturation(u: float, p: Row) -> float:
    """Limit p0, approached as u / (1 + |u / p0|^p1)^(1 / p1)."""
    return float(u / (1.0 + abs(u / p[0]) ** p[1]) ** (1.0 / p[1]))


@numba.njit(cache=True, error_model="numpy")
def exponential(u: float, p: Row) -> float:
    """Progressive gain p1 / p0 (exp(p0 u / p1) - 1): curvature p0 at the size p1, with all orders of the series."""
    return p[1] / p[0] * math.expm1(p[0] * u / p[1])


@numba.njit(cache=True, error_model="numpy")
def gain_law(u: float, p: Row, signal: float) -> float:
    """Gain 1 + p0 (e^(0.4 d) - 1) / 0.4, d the deviation of the signal from p1 in units of p2."""
    d = (signal - p[1]) / p[2]
    return u * (1.0 + p[0] * math.expm1(0.4 * d) / 0.4)


@numba.njit(cache=True, error_model="numpy")
def hum(p: Row, t: float) -> float:
    """Tone of amplitude p0 at p1 rad/s and phase p2, with 15 % of third harmonic."""
    return p[0] * (math.sin(p[1] * t + p[2]) + 0.15 * math.sin(3.0 * (p[1] * t + p[2]) + 0.7))


@numba.njit(cache=True, error_model="numpy")
def coulomb(v: float, p: Row) -> float:
    """Friction p0, sign rounded as an arc tangent over the velocity p1."""
    return -p[0] * 2.0 / math.pi * math.atan(v / p[1])


@numba.njit(cache=True, error_model="numpy")
def stribeck(v: float, p: Row) -> float:
    """Friction p0, p2 times as much at rest, falling with velocity as a Lorentzian of width p3; sign as in `coulomb`."""
    return coulomb(v, p) * (1.0 + (p[2] - 1.0) / (1.0 + (v / p[3]) ** 2))


@numba.njit(cache=True, error_model="numpy")
def quadratic_damping(v: float, p: Row) -> float:
    """Drag -p0 v sqrt(v^2 + p1^2)."""
    return -p[0] * v * math.sqrt(v * v + p[1] * p[1])


@numba.njit(cache=True, error_model="numpy")
def cubic(q: float, p: Row) -> float:
    """Hardening -p0 q^3 (1 + 0.15 (q / p1)^2): a fifth-order term beside the cubic."""
    return -p[0] * q**3 * (1.0 + 0.15 * (q / p[1]) ** 2)


@numba.njit(cache=True, error_model="numpy")
def quadratic(q: float, p: Row) -> float:
    """One-sided stiffness -p0 q^2 (1 + 0.15 q / p1)."""
    return -p[0] * q * q * (1.0 + 0.15 * q / p[1])


@numba.njit(cache=True, error_model="numpy")
def contact(q: float, p: Row) -> float:
    """Contact beyond the clearance p1: -p0 d^1.5 (a Hertzian spot), onset rounded over p2."""
    d = p[2] * softplus((abs(q) - p[1]) / p[2])
    return -math.copysign(p[0] * d**1.5, q)


@numba.njit(cache=True, error_model="numpy")
def tempered_square(y: float, p: Row) -> float:
    """Sensor curve y + p0 y^2 / (p1 + 0.2 |y|)."""
    return y + p[0] * y * y / (p[1] + 0.2 * abs(y))


@numba.njit(cache=True, error_model="numpy")
def rectified(y: float, p: Row) -> float:
    """Unequal halves: y + p0 |y|, corner rounded over p1."""
    return y + p[0] * (math.sqrt(y * y + p[1] * p[1]) - p[1])


@numba.njit(cache=True, error_model="numpy")
def quantised(y: float, p: Row) -> float:
    """Steps of p0 on a grid shifted by p1."""
    return p[0] * math.floor((y - p[1]) / p[0] + 0.5) + p[1]
