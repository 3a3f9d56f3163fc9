"""Laws of the field trials: on commands, as forces on an axis, in processes and sensors; and the numbers they are known by."""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws.scalar import Row, delayed, softplus

# Where a law acts is its number divided by `GROUP`: on the held command once per integration step, on the command inside the
# plant, as a force on an axis (two groups), as a characteristic of the process, as a further branch of it, on the sensor, on
# the reading with its noise. CONSTANT is no law: it changes one constant of the plant.
GROUP = 20
HELD, FLOW, FORCE, MORE_FORCE, CHARACTERISTIC, BRANCH, SENSOR, READOUT = range(8)
CONSTANT = -1

UNEVEN_ZONE, STICKY_ZONE, POWER_CURVE, UNEVEN_LIMIT, PLAYS, SOFT_PLAY, GRID, LATE, SOFT_SLEW, LAME, FOLLOWS = range(11)
TWO_LAGS, RINGING, DROOP, RELAXING, PATCHY_GAIN = range(20, 25)
DRY, STRIBECK, WARMING, PRESSED, BRISTLE, PATCHY, BOUC_WEN = range(40, 47)
DRAG, SLOW_DRAG, ONE_WAY, EMF, SPEED_LIMIT = range(47, 52)
HARDENING, LEANING, GAP, WEIGHT, RIPPLE, RIDER, LOAD, TONE = range(60, 68)
ROOT, MAGNET, INDUCTANCE, HEATING, RADIATION, HARD_SHAFT, LOOSE_SHAFT = range(80, 87)
SPILL, STORE = range(100, 102)
TWO_POLES, CLIPPED, BENT, WARM_UP, CROSSED, ECCENTRIC = range(120, 126)
COARSE = 140

# A law is one row of the table: its code, its place, its first own state, then its values.
CODE, PLACE, OWN, VALUES = range(4)
COLUMNS, MEMORY = 9, 4096
SHARP = (DRY, STRIBECK, WARMING, PRESSED, PATCHY)  # laws with a steep flank: they are integrated in finer steps


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
    if code == UNEVEN_ZONE:
        return uneven_zone(u, p)
    if code == POWER_CURVE:
        return math.copysign(p[1] * (abs(u) / p[1]) ** (1.0 + p[0]), u)
    if code == UNEVEN_LIMIT:
        return uneven_limit(u, p)
    if code == GRID:
        return p[0] * math.floor(u / p[0] + 0.5)
    if code == LAME:
        return u + p[0] * (math.sqrt(u * u + p[1] * p[1]) - p[1])
    if code == FOLLOWS:
        d = (aux - p[1]) / p[2]
        return u * (1.0 + p[0] * (d + 0.2 * d * d))
    return u


@numba.njit(cache=True, error_model="numpy")
def _remembered(code: int, u: float, p: Row, m: Row, h: float) -> float:
    if code == STICKY_ZONE:
        return sticky_zone(u, p, m, h)
    if code == PLAYS:
        return plays(u, p, m)
    if code == SOFT_PLAY:
        return soft_play(u, p, m)
    if code == LATE:
        return delayed(u, m, p[0] / h, True)
    if code == SOFT_SLEW:
        return soft_slew(u, p, m, h)
    return u


@numba.njit(cache=True, error_model="numpy")
def held(law, m, i, u, aux, h):  # type: ignore[no-untyped-def]
    """Return command i after every law on its held value, in order; called once per integration step of h seconds."""
    for e in range(law.shape[0]):
        code = int(law[e, CODE])
        if code // GROUP == HELD and law[e, PLACE] == i:
            p = law[e, VALUES :]
            u = _remembered(code, _shaped(code, u, p, aux), p, m[e], h)
    return u


@numba.njit(cache=True, error_model="numpy")
def _flowing(code, p, o, u, q, X, dX):  # type: ignore[no-untyped-def]
    if code == TWO_LAGS:
        dX[o], dX[o + 1] = (u - X[o]) / p[0], (X[o] - X[o + 1]) / p[0]
        return X[o + 1]
    if code == RINGING:
        dX[o], dX[o + 1] = X[o + 1], p[0] * p[0] * (u - X[o]) - 2.0 * p[1] * p[0] * X[o + 1]
        return X[o] + 0.1 * p[1] / p[0] * X[o + 1]
    if code == DROOP:
        dX[o] = (abs(u) / p[1] - X[o]) / p[2]
        return u * (1.0 - p[0] * X[o] / (1.0 + 0.3 * X[o]))
    if code == RELAXING:
        for j in range(3):
            dX[o + j] = (u - X[o + j]) / (p[1] * 4.0**j)
        return u + p[0] * (X[o] + 0.8 * X[o + 1] + 0.6 * X[o + 2]) / 2.4
    if code == PATCHY_GAIN:
        return u * (1.0 + p[0] * math.sin(q / p[1] + p[2]))
    return u


@numba.njit(cache=True, error_model="numpy")
def flow(law, i, u, q, X, dX):  # type: ignore[no-untyped-def]
    """Return command i after every law inside the plant; q is the position its actuator is at, own states are in X."""
    for e in range(law.shape[0]):
        code = int(law[e, CODE])
        if code // GROUP == FLOW and law[e, PLACE] == i:
            u = _flowing(code, law[e, VALUES :], int(law[e, OWN]), u, q, X, dX)
    return u


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
    if code == DRY:
        return dry(v, p)
    if code == STRIBECK:
        return stribeck(v, p)
    if code == PRESSED:
        return -p[0] * (abs(load) + 0.1 * p[2]) * way(v, p[1])
    if code == PATCHY:
        return -p[0] * (1.0 + p[2] * math.sin(q / p[3] + p[4])) * way(v, p[1])
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _dragging(code: int, v: float, p: Row) -> float:
    if code == DRAG:
        return -p[0] * v * abs(v) * (1.0 + 0.1 * math.tanh(v / p[1]))
    if code == SLOW_DRAG:
        return -math.copysign(p[0] * abs(v) ** 1.5, v)
    if code == ONE_WAY:
        return -p[0] * 0.5 * v * (1.0 + way(v, p[1]))
    if code == EMF:
        return p[0] * (v - p[1] * math.tanh(v / p[1]))
    if code == SPEED_LIMIT:
        return -math.copysign(p[0] * p[2] * softplus((abs(v) - p[1]) / p[2]), v)
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _holding(code: int, q: float, t: float, p: Row) -> float:
    if code == HARDENING:
        return hard_spring(q, p)
    if code == LEANING:
        return leaning_spring(q, p)
    if code == GAP:
        return gap(q, p)
    if code == WEIGHT:
        return weight(q, p)
    if code == RIPPLE:
        return ripple(q, p)
    if code == LOAD:
        return p[0] * (1.0 + 0.02 * math.sin(t / p[1]))
    if code == TONE:
        return p[0] * (math.sin(p[1] * t + p[2]) + 0.2 * math.sin(2.0 * (p[1] * t + p[2])))
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def _remembering(code, p, o, v, X, dX):  # type: ignore[no-untyped-def]
    if code == WARMING:  # friction p0 falls by p2 at most while |v| / p3, averaged over p4, keeps it warm
        dX[o] = (abs(v) / p[3] - X[o]) / p[4]
        return -p[0] * (1.0 - p[2] * X[o] / (1.0 + X[o])) * way(v, p[1])
    if code == BRISTLE:  # bristles of reach p1, p2 times stiffer at rest than beyond p3
        dX[o] = (v - abs(v) * X[o]) / p[1]
        return -p[0] * (X[o] * (1.0 + p[2] * math.exp(-((v / p[3]) ** 2))) + 0.1 * p[1] / p[3] * dX[o])
    if code == BOUC_WEN:  # width p1, exponent p2, skew p3
        turning = p[3] + (1.0 - p[3]) * math.copysign(1.0, v * X[o])
        dX[o] = v / p[1] * (1.0 - abs(X[o]) ** p[2] * turning)
        return -p[0] * X[o]
    if code == RIDER:  # a mass p0 on a spring of p1 rad/s, damping ratio p2; states: stretch and its own speed
        dX[o] = X[o + 1] - v
        dX[o + 1] = -p[1] * p[1] * X[o] - 2.0 * p[2] * p[1] * (X[o + 1] - v)
        return -p[0] * dX[o + 1]
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def force(law, axis, q, v, load, t, X, dX):  # type: ignore[no-untyped-def]
    """Return the sum of all forces on an axis at position q, speed v and driving force ``load``, at time t."""
    total = 0.0
    for e in range(law.shape[0]):
        code = int(law[e, CODE])
        if (code // GROUP == FORCE or code // GROUP == MORE_FORCE) and law[e, PLACE] == axis:
            p = law[e, VALUES :]
            total += _rubbing(code, q, v, load, p) + _dragging(code, v, p) + _holding(code, q, t, p)
            total += _remembering(code, p, int(law[e, OWN]), v, X, dX)
    return total


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
    if code == ROOT:
        return linear * root(x, p)
    if code == MAGNET:
        return magnet(x, y, a, b, p)
    if code == INDUCTANCE:
        z = (x / p[0]) ** 2
        return linear * (1.0 + z / (1.0 + 0.2 * z))
    if code == RADIATION:
        z = max(x / p[0], -1.0)
        return linear * (1.0 + 1.5 * z + z * z + 0.25 * z**3)
    if code == HARD_SHAFT:
        return linear + a * (p[0] * math.sinh(x / p[0]) - x)
    if code == LOOSE_SHAFT:
        return linear - a * p[0] * math.tanh(x / p[0])
    return linear


@numba.njit(cache=True, error_model="numpy")
def characteristic(law, place, x, y, a, b, X, dX):  # type: ignore[no-untyped-def]
    """Return what the process has in place of ``a x + b y`` at a place of the plant."""
    total = a * x + b * y
    for e in range(law.shape[0]):
        code = int(law[e, CODE])
        if code // GROUP == CHARACTERISTIC and law[e, PLACE] == place:
            p, o = law[e, VALUES :], int(law[e, OWN])
            if code == HEATING:  # loss a x grows by p0 per unit of warmth, heated by (x / p1)^2 over p2 seconds
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
        code = int(law[e, CODE])
        if code // GROUP == BRANCH and law[e, PLACE] == place:
            p, o = law[e, VALUES :], int(law[e, OWN])
            if code == SPILL:  # beyond the rim p1 (rounded over p2) it runs off at p0 per second
                total -= p[0] * p[2] * softplus((x - p[1]) / p[2])
            else:  # a further store exchanges at p0 per second and fills at p1 per second
                dX[o] = p[1] * (x - X[o])
                total -= p[0] * (x - X[o])
    return total


@numba.njit(cache=True, error_model="numpy")
def _sensed(code, p, o, y, other, t, X, dX):  # type: ignore[no-untyped-def]
    if code == TWO_POLES:
        dX[o], dX[o + 1] = (y - X[o]) / p[0], (X[o] - X[o + 1]) / (0.3 * p[0])
        return X[o + 1]
    if code == CLIPPED:
        return uneven_limit(y, p)
    if code == BENT:
        return y + p[0] * y * y / (p[1] * (1.0 + 0.2 * (y / p[1]) ** 2))
    if code == WARM_UP:
        return y + p[0] * (1.0 - math.exp(-t / p[1]))
    if code == CROSSED:
        return y + p[0] * other
    if code == ECCENTRIC:
        return y + p[0] * (math.sin(y / p[1] + p[2]) + 0.3 * math.sin(2.0 * y / p[1]))
    return y


@numba.njit(cache=True, error_model="numpy")
def sensed(law, i, y, other, t, X, dX):  # type: ignore[no-untyped-def]
    """Return what the sensor of output i makes of y; ``other`` is the next output, t the time since the run began."""
    for e in range(law.shape[0]):
        code = int(law[e, CODE])
        if code // GROUP == SENSOR and law[e, PLACE] == i:
            y = _sensed(code, law[e, VALUES :], int(law[e, OWN]), y, other, t, X, dX)
    return y


@numba.njit(cache=True, error_model="numpy")
def readout(law, i, y):  # type: ignore[no-untyped-def]
    """Return the reading of output i after its noise: steps of p0."""
    for e in range(law.shape[0]):
        if law[e, CODE] == COARSE and law[e, PLACE] == i:
            y = law[e, VALUES] * math.floor(y / law[e, VALUES] + 0.5)
    return y
