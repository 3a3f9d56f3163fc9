"""Calls of the laws of effects from compiled code: explicit, and implicit for friction."""

from __future__ import annotations

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]

from afdsvc.explain.simulate.calls import pointer

LAW = types.void(types.float64[::1], types.float64[::1], types.float64[::1], types.float64, types.float64[::1])
MOST_EFFECTS = 8
MOST_SIGNALS = 16
READS = 7  # columns of a plan: stage, reads, writes, parameters, memory from, memory to, bent, then addresses
INPUT, FORCE, OUTPUT, FRICTION = 0, 1, 2, 3
IMPLICIT = 0.6  # point of the sub-step where friction is evaluated: 0.5 would chatter at rest, 1 is of first order
SHARP = 0.02  # share of the sub-step that an implicit law gets as dt: it need not be smooth over the whole
PASSES = 30  # most evaluations of a friction law in one sub-step


@njit(cache=True, nogil=True)
def _evaluate(i, laws, plan, par, mem, work, dt):  # type: ignore[no-untyped-def]
    """Call law ``i`` on the signals at the start of ``work``; what it adds is left from `MOST_SIGNALS` on.

    A bent law is multiplied by ``1 + c1 w + c2 w^2``, ``w`` the size of its first signal over a reference (the last parameters).
    """
    nwrite = plan[i, 2]
    z = carray(pointer(work.ctypes.data), plan[i, 1], np.float64)  # type: ignore[call-arg]
    out = carray(pointer(work.ctypes.data + 8 * MOST_SIGNALS), nwrite, np.float64)
    values = carray(pointer(par.ctypes.data + 8 * i * par.shape[1]), plan[i, 3], np.float64)
    memory = carray(pointer(mem.ctypes.data + 8 * plan[i, 4]), plan[i, 5] - plan[i, 4], np.float64)
    for k in range(nwrite):
        out[k] = 0.0
    first = z[0]
    laws[i](values, z, memory, dt, out)
    if plan[i, 6]:
        w = abs(first) / par[i, par.shape[1] - 1]
        for k in range(nwrite):
            out[k] *= 1.0 + par[i, par.shape[1] - 3] * w + par[i, par.shape[1] - 2] * w * w


@njit(cache=True, nogil=True)
def apply_laws(stage, laws, plan, par, mem, s, work, dt, target, base):  # type: ignore[no-untyped-def]
    """Add to ``target`` what every effect of this stage contributes, given the signals ``s``.

    With ``base >= 0`` the signals from there on are kept equal to the target, so later effects see earlier ones.
    """
    for i in range(plan.shape[0]):
        if plan[i, 0] != stage:
            continue
        for k in range(plan[i, 1]):
            work[k] = s[plan[i, READS + k]]
        _evaluate(i, laws, plan, par, mem, work, dt)
        for k in range(plan[i, 2]):
            j = plan[i, READS + MOST_SIGNALS + k]
            target[j] += work[MOST_SIGNALS + k]
            if base >= 0:
                s[base + j] = target[j]


@njit(cache=True, nogil=True)
def _share(r, i, laws, plan, par, mem, s, work, dt, base, new, gxt, first):  # type: ignore[no-untyped-def]
    """Return the law's force along ``first``, in units of it, when ``r`` times ``first`` acts over the sub-step."""
    size, along = 0.0, 0.0
    n = new.size
    for k in range(plan[i, 1]):
        a = plan[i, READS + k]
        value = s[a]
        if base <= a < base + n:
            j = a - base
            end = new[j]
            for q in range(plan[i, 2]):
                end += r * first[q] * gxt[plan[i, READS + MOST_SIGNALS + q], j]
            value += IMPLICIT * (end - value)
        work[k] = value
    _evaluate(i, laws, plan, par, mem, work, SHARP * dt)
    for q in range(plan[i, 2]):
        size += first[q] * first[q]
        along += first[q] * work[MOST_SIGNALS + q]
    return along / size


@njit(cache=True, nogil=True)
def friction(laws, plan, par, mem, s, work, dt, base, x, new, gxt, first):  # type: ignore[no-untyped-def]
    """Add friction to ``new``, the states at the end of the sub-step without it; the signals from ``base`` are set to ``x``.

    The force ``f = law(x + 0.6 (x+ - x))`` acts over the sub-step and depends on the state ``x+`` it leads to. It is solved
    for along the direction of the explicit force, by regula falsi (Illinois) between none and all of it. At rest the force
    balances the others, so an axis sticks; just off the middle the method damps what remains.
    """
    for i in range(plan.shape[0]):
        if plan[i, 0] != FRICTION:
            continue
        for j in range(x.size):
            s[base + j] = x[j]
        for q in range(plan[i, 2]):
            first[q] = 0.0
        _start(i, laws, plan, par, mem, s, work, dt, base, new, first)
        if not np.any(first[: plan[i, 2]] != 0.0):
            continue
        r = _solve(i, laws, plan, par, mem, s, work, dt, base, new, gxt, first)
        for q in range(plan[i, 2]):
            for j in range(x.size):
                new[j] += r * first[q] * gxt[plan[i, READS + MOST_SIGNALS + q], j]


@njit(cache=True, nogil=True)
def _start(i, laws, plan, par, mem, s, work, dt, base, new, first):  # type: ignore[no-untyped-def]
    """Write the explicit force, with no friction during the sub-step, into ``first``."""
    for k in range(plan[i, 1]):
        a = plan[i, READS + k]
        work[k] = s[a] + (IMPLICIT * (new[a - base] - s[a]) if base <= a < base + new.size else 0.0)
    _evaluate(i, laws, plan, par, mem, work, SHARP * dt)
    for q in range(plan[i, 2]):
        first[q] = work[MOST_SIGNALS + q]


@njit(cache=True, nogil=True)
def _solve(i, laws, plan, par, mem, s, work, dt, base, new, gxt, first):  # type: ignore[no-untyped-def]
    """Return ``r`` in [0, 1] with ``_share(r) = r``; where the law does not oppose motion, one pass of iteration."""
    low, high = 0.0, 1.0
    at_low = 1.0
    at_high = _share(1.0, i, laws, plan, par, mem, s, work, dt, base, new, gxt, first) - 1.0
    if at_high >= 0.0 or at_high > -1e-12:
        return min(1.0 + at_high, 1.5)
    side = 0
    r = 1.0
    for _ in range(PASSES):
        r = (low * at_high - high * at_low) / (at_high - at_low)
        at = _share(r, i, laws, plan, par, mem, s, work, dt, base, new, gxt, first) - r
        if abs(at) < 1e-10 or high - low < 1e-12:
            break
        if at > 0.0:
            low, at_low = r, at
            if side == 1:
                at_high *= 0.5
            side = 1
        else:
            high, at_high = r, at
            if side == -1:
                at_low *= 0.5
            side = -1
    return r
