"""From the number of a law to its call, in groups small enough to read.

Arguments of every group: ``at`` the indices the law acts on, ``p`` its parameters, ``aux`` the auxiliary signals now,
``s`` and ``ds`` its own states and their rates, ``m`` its memory, ``clock`` absolute time, time since the recording began,
and the length of the integration step (all in s).
"""

from __future__ import annotations

import math

import numba

from afdsvc.trial.laws import scalar as c
from afdsvc.trial.laws import scalar as ml
from afdsvc.trial.laws import scalar as sl
from afdsvc.trial.laws import scalar as st
from afdsvc.trial.laws.scalar import Row


@numba.njit(cache=True, error_model="numpy")
def on_command(code: int, at: list[int], p: Row, v: Row, aux: Row, clock: Row) -> None:
    """Laws without memory, on the command v in place."""
    i = at[0]
    if code == c.DEAD_ZONE:
        v[i] = sl.dead_zone(v[i], p)
    elif code == c.SATURATION:
        v[i] = sl.saturation(v[i], p)
    elif code == c.STATIC_NONLINEARITY:
        v[i] = sl.exponential(v[i], p)
    elif code == c.GAIN_FOLLOWS_AUX:
        v[i] = sl.gain_law(v[i], p, aux[at[1]])
    elif code == c.PERIODIC:
        v[i] += sl.hum(p, clock[0])


@numba.njit(cache=True, error_model="numpy")
def on_command_with_memory(
    code: int, at: list[int], p: Row, v: Row, s: Row, ds: Row, m: Row, clock: Row, commit: bool
) -> None:
    """Laws with memory, on the command v in place."""
    i = at[0]
    if code == c.DELAY:
        v[i] = ml.delayed(v[i], m, p[0] / clock[2], commit)
    elif code == c.LAG:
        v[i] = ml.lag(v[i], p, m, clock[2], commit)
    elif code == c.RESONANCE:
        v[i] = st.resonance(v[i], p, s, ds)
    elif code == c.BACKLASH:
        v[i] = ml.backlash(v[i], p, m, commit)
    elif code == c.HYSTERESIS:
        v[i] = ml.hysteresis(v[i], p, m, commit)
    elif code == c.CREEP:
        v[i] = st.creep(v[i], p, s, ds)
    elif code == c.SLEW:
        v[i] = ml.slew(v[i], p, m, clock[2], commit)
    elif code == c.MEMORY_POLYNOMIAL:
        v[i] = st.memory_polynomial(v[i], p, s, ds)


@numba.njit(cache=True, error_model="numpy")
def on_axis(code: int, at: list[int], p: Row, x: Row, clock: Row, dx: Row) -> None:
    """Forces on one axis (position at[0], velocity at[1]) that follow from its state at once, added to dx."""
    q, v = x[at[0]], x[at[1]]
    if code == c.COULOMB:
        dx[at[1]] += sl.coulomb(v, p)
    elif code == c.STRIBECK:
        dx[at[1]] += sl.stribeck(v, p)
    elif code == c.QUADRATIC_DAMPING:
        dx[at[1]] += sl.quadratic_damping(v, p)
    elif code == c.CUBIC:
        dx[at[1]] += sl.cubic(q, p)
    elif code == c.QUADRATIC:
        dx[at[1]] += sl.quadratic(q, p)
    elif code == c.CLEARANCE:
        dx[at[1]] += sl.contact(q, p)
    elif code == c.CONSTANT_LOAD:
        dx[at[1]] += p[0] * (1.0 + 0.03 * math.sin(0.4 * clock[0]))
    elif code == c.PERIODIC_FORCE:
        dx[at[1]] += sl.hum(p, clock[0])


@numba.njit(cache=True, error_model="numpy")
def on_axis_with_memory(
    code: int, at: list[int], p: Row, x: Row, s: Row, ds: Row, m: Row, dx: Row, commit: bool
) -> None:
    """Forces on one axis that depend on its past, added to dx."""
    q, v = x[at[0]], x[at[1]]
    if code == c.FLEXIBLE_MODE:
        dx[at[1]] += st.flexible_mode(q, v, p, s, ds)
    elif code == c.HYSTERETIC_FORCE:
        dx[at[1]] += st.hysteretic_force(v, p, s, ds)
    elif code == c.FRACTIONAL:
        dx[at[1]] += st.fractional_damping(v, p, s, ds)
    elif code == c.STICK_SLIP:
        dx[at[1]] += ml.stick_slip(q, p, m, commit)


@numba.njit(cache=True, error_model="numpy")
def on_machine(code: int, at: list[int], p: Row, x: Row, v: Row, aux: Row, clock: Row, dx: Row) -> None:
    """Forces between axes or from the rotor, added to dx; at[4] is the auxiliary signal or the command they follow."""
    if code == c.GYROSCOPIC:
        st.gyroscopic(at, p, x, aux[at[4]], dx)
    elif code == c.CROSS_COUPLED:
        st.cross_coupled(at, p, x, aux[at[4]], dx)
    elif code == c.UNBALANCE:
        st.unbalance(at, p, aux[at[4]], aux[at[5]], dx)
    elif code == c.STIFFNESS_FOLLOWS_AUX:
        st.stiffness_follows(at, p, x, aux[at[4]], dx)
    elif code == c.PARAMETRIC:
        st.parametric(at, p, x, clock[0], dx)
    elif code == c.BILINEAR:
        st.bilinear(at, p, x, v, dx)


@numba.njit(cache=True, error_model="numpy")
def on_sensor(code: int, at: list[int], p: Row, y: Row, clock: Row) -> None:
    """What a sensor makes of the output at once, on y in place (at[0] the output, at[1] another one)."""
    i = at[0]
    if code == c.CROSSTALK:
        y[i] += p[0] * y[at[1]]
    elif code == c.MISALIGNMENT:
        first, second = y[i], y[at[1]]
        y[i] = math.cos(p[0]) * first + math.sin(p[0]) * second
        y[at[1]] = math.cos(0.9 * p[0]) * second - math.sin(0.9 * p[0]) * first
    elif code == c.OFFSET:
        y[i] += p[0]
    elif code == c.DRIFT:
        y[i] += p[0] * (1.0 - math.exp(-clock[1] / p[1]))
    elif code == c.SENSOR_NONLINEARITY:
        y[i] = sl.tempered_square(y[i], p)
    elif code == c.RECTIFICATION:
        y[i] = sl.rectified(y[i], p)
    elif code == c.SENSOR_SATURATION:
        y[i] = sl.saturation(y[i], p)


@numba.njit(cache=True, error_model="numpy")
def on_sensor_with_memory(code: int, at: list[int], p: Row, y: Row, aux: Row, m: Row, clock: Row) -> None:
    """What a sensor makes of the output and of time, on y in place; called once per integration step."""
    i, h = at[0], clock[2]
    if code == c.SENSOR_LAG:
        y[i] = ml.ramp_lag(ml.ramp_lag(y[i], p[0], m, 0, h), ml.SECOND_POLE * p[0], m, 2, h)
    elif code == c.SENSOR_DELAY:
        y[i] = ml.delayed(y[i], m, p[0] / h, True)
    elif code == c.RUNOUT:
        a = aux[at[1]]
        y[i] += p[0] * (math.cos(a + p[1]) + p[2] * math.cos(2 * a + p[3]) + p[4] * math.cos(3 * a) + 0.1 * math.cos(5 * a))
    elif code == c.PERIODIC_SENSED:
        y[i] += sl.hum(p, clock[0])
    elif code == c.SENSED_GAIN_FOLLOWS_AUX:
        y[i] = sl.gain_law(y[i], p, aux[at[1]])
