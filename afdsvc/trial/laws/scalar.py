"""Laws of the truth generator as functions of numbers, and the codes they are known by.

Every one is smooth, or uses an exponent, that a textbook law has not. A law that remembers is evaluated several times inside one
integration step of length ``h`` and once at its end with ``commit`` set, when it may write its memory ``m`` (zero at the beginning).
Laws of a held command return their mean over the step: jumps at its start would otherwise be weighed wrongly.
"""

from __future__ import annotations

import math

import numba
import numpy as np

Row = list[float]  # what a law reads and writes by number; compiled, a one-dimensional array

# Where a law acts, which is its number without the last digit: on the command before it drives the plant, on the rates of
# the states, on the sensed output, on the reading (the output with its noise).
COMMAND, COMMAND_WITH_MEMORY, AXIS, AXIS_WITH_MEMORY, MACHINE, SENSOR, SENSOR_WITH_MEMORY, READING = range(8)
# What is no law: a change of the plant's constants, more noise.
CONSTANT, NOISE = -1, -2

# Without memory, on the command.
DEAD_ZONE, SATURATION, STATIC_NONLINEARITY, GAIN_FOLLOWS_AUX, PERIODIC = range(5)
# With memory, on the command.
DELAY, LAG, RESONANCE, BACKLASH, HYSTERESIS, CREEP, SLEW, MEMORY_POLYNOMIAL = range(10, 18)
# On one axis.
COULOMB, STRIBECK, QUADRATIC_DAMPING, CUBIC, QUADRATIC, CLEARANCE, CONSTANT_LOAD, PERIODIC_FORCE = range(20, 28)
# On one axis, with states or memory of their own.
FLEXIBLE_MODE, HYSTERETIC_FORCE, FRACTIONAL, STICK_SLIP = range(30, 34)
# On the machine.
GYROSCOPIC, CROSS_COUPLED, UNBALANCE, STIFFNESS_FOLLOWS_AUX, PARAMETRIC, BILINEAR = range(40, 46)
# On the sensor.
CROSSTALK, MISALIGNMENT, OFFSET, DRIFT, SENSOR_NONLINEARITY, RECTIFICATION, SENSOR_SATURATION = range(50, 57)
SENSOR_LAG, SENSOR_DELAY, RUNOUT, PERIODIC_SENSED, SENSED_GAIN_FOLLOWS_AUX = range(60, 65)
QUANTISATION = 70

PARAMETERS, PLACES, MEMORY = 8, 6, 512  # columns of the tables: values of a law, indices it acts on, its memory


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


# s^-1/2 = (1/pi) integral of x^-1/2 / (s + x) dx, as a sum over nodes evenly spaced in log x.
_SPACING = 1.15
NODES = 4.0 * np.exp(_SPACING * np.arange(8))  # 4 to 12,500 rad/s
WEIGHTS = np.sqrt(NODES) * _SPACING / np.pi
WEIGHTS[0] += 2 / np.pi * np.sqrt(NODES[0]) * np.exp(-_SPACING / 4)  # all that lies below the lowest node
ABOVE = 2 / np.pi / np.sqrt(NODES[-1]) * np.exp(-_SPACING / 4)  # all that lies above the highest


@numba.njit(cache=True, error_model="numpy")
def resonance(u: float, p: Row, s: Row, ds: Row) -> float:
    """Second order, p0 rad/s, damping ratio p1, with a relaxing branch (10 % of the stiffness, cut at 2 p0): gain 1 at rest."""
    w = p[0]
    ds[0] = s[1]
    ds[1] = w * w * (u - s[0]) - 2.0 * p[1] * w * s[1] - 0.1 * w * w * (s[0] - s[2])
    ds[2] = 2.0 * w * (s[0] - s[2])
    return s[0]


@numba.njit(cache=True, error_model="numpy")
def creep(u: float, p: Row, s: Row, ds: Row) -> float:
    """Logarithmic creep as three equal relaxations 30 ms, 0.2 s and 1.4 s: u + p0 times their mean."""
    ds[0] = (u - s[0]) / 0.03
    ds[1] = (u - s[1]) / 0.2
    ds[2] = (u - s[2]) / 1.4
    return u + p[0] * (s[0] + s[1] + s[2]) / 3.0


@numba.njit(cache=True, error_model="numpy")
def memory_polynomial(u: float, p: Row, s: Row, ds: Row) -> float:
    """u + p0 u (w / p1 + (w / p1)^2), w the command of p2 seconds before (as a lag): products of now and before."""
    ds[0] = (u - s[0]) / p[2]
    w = s[0] / p[1]
    return u + p[0] * u * (w + w * w)


@numba.njit(cache=True, error_model="numpy")
def flexible_mode(q: float, v: float, p: Row, s: Row, ds: Row) -> float:
    """A mass p0 (relative) on a joint of p1 rad/s, damping ratio p2, 10 % stiffer at a stretch p3 by contact that grows; its pull on the axis."""
    stretch = s[0] - q
    ds[0] = s[1]
    ds[1] = -p[1] ** 2 * stretch * (1.0 + 0.1 * abs(stretch / p[3]) ** 1.5) - 2.0 * p[2] * p[1] * (s[1] - v)
    return -p[0] * ds[1]


@numba.njit(cache=True, error_model="numpy")
def hysteretic_force(v: float, p: Row, s: Row, ds: Row) -> float:
    """Bouc-Wen force -p0 z; z is driven by the motion in units of p1, with exponent p2 and skew p3."""
    z = s[0]
    turning = p[3] + (1.0 - p[3]) * math.copysign(1.0, v * z)
    ds[0] = v / p[1] * (1.0 - abs(z) ** p[2] * turning)
    return -p[0] * z


@numba.njit(cache=True, error_model="numpy")
def fractional_damping(v: float, p: Row, s: Row, ds: Row) -> float:
    """-p0 times the half derivative of the position, by the nodes above."""
    total = ABOVE * v
    for k in range(8):
        ds[k] = v - NODES[k] * s[k]
        total += WEIGHTS[k] * s[k]
    return float(-p[0] * total)


@numba.njit(cache=True, error_model="numpy")
def gyroscopic(at: list[int], p: Row, x: Row, speed: float, dx: Row) -> None:
    """Turning rotor: -p0 speed v2 on the first axis, 0.9 p0 speed v1 on the second (an inertia not quite round)."""
    dx[at[1]] -= p[0] * speed * x[at[3]]
    dx[at[3]] += 0.9 * p[0] * speed * x[at[1]]


@numba.njit(cache=True, error_model="numpy")
def cross_coupled(at: list[int], p: Row, x: Row, speed: float, dx: Row) -> None:
    """Swirling film: -k q2 on the first axis, k q1 on the second, k = p0 (speed / p1)^0.9."""
    k = p[0] * abs(speed / p[1]) ** 0.9
    dx[at[1]] -= k * x[at[2]]
    dx[at[3]] += k * x[at[0]]


@numba.njit(cache=True, error_model="numpy")
def unbalance(at: list[int], p: Row, speed: float, angle: float, dx: Row) -> None:
    """Eccentricity p0 at phase p1, 5 % weaker on the second axis."""
    pull = p[0] * speed * speed
    dx[at[1]] += pull * math.cos(angle + p[1])
    dx[at[3]] += 0.95 * pull * math.sin(angle + p[1])


@numba.njit(cache=True, error_model="numpy")
def stiffness_follows(at: list[int], p: Row, x: Row, signal: float, dx: Row) -> None:
    """Stiffness p3 (first axis) and p4 (second) grow by p0 (e^(0.4 d) - 1) / 0.4, d the signal's deviation from p1 in units of p2."""
    d = (signal - p[1]) / p[2]
    more = p[0] * math.expm1(0.4 * d) / 0.4
    dx[at[1]] -= more * p[3] * x[at[0]]
    if at[3] >= 0:
        dx[at[3]] -= more * p[4] * x[at[2]]


@numba.njit(cache=True, error_model="numpy")
def parametric(at: list[int], p: Row, x: Row, t: float, dx: Row) -> None:
    """Stiffness p3 modulated by p0 sin(p1 t + p2)."""
    dx[at[1]] -= p[0] * p[3] * math.sin(p[1] * t + p[2]) * x[at[0]]


@numba.njit(cache=True, error_model="numpy")
def bilinear(at: list[int], p: Row, x: Row, v: Row, dx: Row) -> None:
    """Damping of the axis modulated by a command: p0 (command / p1) velocity."""
    dx[at[1]] += p[0] * v[at[4]] / p[1] * x[at[1]]


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
