"""Laws that remember: what a number becomes, given what it was before.

A law is asked several times inside one integration step of length ``h`` and once at its end with ``commit`` set, when it may
write its memory ``m`` (zero at the beginning). Laws of a held command return their mean over the step: jumps at its start
would otherwise be weighed wrongly.
"""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws.codes import Row

SECOND_POLE = 0.15  # a lag's second, faster time constant, as a share of the first


@numba.njit(cache=True, error_model="numpy")
def delayed(u: float, m: Row, steps: float, commit: bool) -> float:
    """Return u as it was ``steps`` integration steps ago (fractions by interpolation, exact for held commands in the mean)."""
    size = len(m) - 1
    head, whole = int(m[0]), int(steps)
    newer = u if whole == 0 else m[1 + (head - whole) % size]
    older = m[1 + (head - whole - 1) % size]
    if commit:
        m[1 + head % size] = u
        m[0] = head + 1.0
    return newer + (steps - whole) * (older - newer)


@numba.njit(cache=True, error_model="numpy")
def lag(u: float, p: Row, m: Row, h: float, commit: bool) -> float:
    """Time constant p0 and a second pole at `SECOND_POLE` p0, solved exactly for an input held during the step: its mean."""
    a, b = 1.0 / p[0], 1.0 / (SECOND_POLE * p[0])
    ea, eb = math.exp(-a * h), math.exp(-b * h)
    fall, cross = m[0] - u, (m[0] - u) * b / (b - a)
    mean = u + (m[1] - u - cross) * (1.0 - eb) / (b * h) + cross * (1.0 - ea) / (a * h)
    if commit:
        m[0], m[1] = u + fall * ea, u + (m[1] - u) * eb + cross * (ea - eb)
    return mean


@numba.njit(cache=True, error_model="numpy")
def ramp_lag(y: float, tau: float, m: Row, at: int, h: float) -> float:
    """First-order lag over one step in which the input went straight from m[at + 1] to y; exact, memory at m[at]."""
    slope = (y - m[at + 1]) / h
    m[at] = y - slope * tau + (m[at] - m[at + 1] + slope * tau) * math.exp(-h / tau)
    m[at + 1] = y
    return m[at]


@numba.njit(cache=True, error_model="numpy")
def backlash(u: float, p: Row, m: Row, commit: bool) -> float:
    """Mean of five plays, half widths 0.8 to 1.2 of p0: an edge worn unevenly."""
    total = 0.0
    for k in range(5):
        w = p[0] * (0.8 + 0.1 * k)
        place = min(max(m[k], u - w), u + w)
        total += place
        if commit:
            m[k] = place
    return total / 5.0


@numba.njit(cache=True, error_model="numpy")
def bouc_wen_slope(z: float, direction: float, p: Row) -> float:
    """Return dz/d(u / p1) of the Bouc-Wen loop of exponent p2 and skew p3, for motion in this direction."""
    turning = p[3] + (1.0 - p[3]) * math.copysign(1.0, direction * z)
    return float(1.0 - abs(z) ** p[2] * turning)


@numba.njit(cache=True, error_model="numpy")
def hysteresis(u: float, p: Row, m: Row, commit: bool) -> float:
    """Rate-independent loop u - p0 p1 z, z the Bouc-Wen variable driven by u (memory: z and the last u)."""
    z, step = m[0], (u - m[1]) / 8.0
    for _ in range(8):
        z += step / p[1] * bouc_wen_slope(z, step, p)
        z = min(max(z, -1.0), 1.0)
    if commit:
        m[0], m[1] = z, u
    return u - p[0] * p[1] * z


@numba.njit(cache=True, error_model="numpy")
def servo(way: float, size: float, t: float) -> float:
    """Return what is left of a positive ``way`` after t (in time constants) of ``dw/dt = -size tanh(w / size)``: exactly."""
    a = way / size
    grown = a + math.log1p(-math.exp(-2.0 * a)) - math.log(2.0) - t  # log sinh, without overflow
    if grown > 0.0:
        return size * (grown + math.log1p(math.sqrt(1.0 + math.exp(-2.0 * grown))))
    return size * math.asinh(math.exp(grown))


@numba.njit(cache=True, error_model="numpy")
def slew(u: float, p: Row, m: Row, h: float, commit: bool) -> float:
    """A servo whose speed saturates, as tanh of its way over p1, at p0 per second upwards and 0.85 p0 downwards: its mean over the step."""
    way = u - m[0]
    if way == 0.0:
        return u
    t = (p[0] if way > 0 else 0.85 * p[0]) * h / p[1]
    half, end = servo(abs(way), p[1], 0.5 * t), servo(abs(way), p[1], t)
    if commit:
        m[0] = u - math.copysign(end, way)
    return u - math.copysign((abs(way) + 4.0 * half + end) / 6.0, way)


@numba.njit(cache=True, error_model="numpy")
def stick_slip(q: float, p: Row, m: Row, commit: bool) -> float:
    """A bristle of stiffness p0 that lets go at a random stretch around p1 and grips again where it then is.

    Memory: anchor, stretch at which it lets go, state of the random sequence (seeded by p2).
    """
    if commit:
        if m[2] == 0.0:
            m[2] = p[2]
            m[1] = p[1]
        if abs(q - m[0]) > m[1]:
            m[0] = q
            m[2] = (m[2] * 16807.0) % 2147483647.0
            m[1] = p[1] * (0.4 + 1.2 * m[2] / 2147483647.0)
    return -p[0] * (q - m[0])
