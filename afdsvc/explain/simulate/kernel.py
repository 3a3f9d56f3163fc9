"""The compiled simulation: a plant with effects at its inputs, forces and outputs, in or out of its loop.

A linear plant is advanced exactly (matrix exponentials), Python code by the classical Runge-Kutta method of order four. Forces
of effects are evaluated at the predicted middle of the sub-step and held over it, an error of second order; friction, which
is nearly a jump, is implicit (`friction`). Inputs are held between samples; what effects make of them is worked out in
every sub-step. With a gain ``Kp`` the states are corrected by ``y - yhat`` at every sample, which makes the residual that
of a one-step predictor; in the loop (``closed``) the simulated output feeds the controller and nothing is corrected.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.core.types import FunctionType

from afdsvc.explain.simulate.calls import call_dynamics
from afdsvc.explain.simulate.laws import FORCE, FRICTION, INPUT, LAW, MOST_EFFECTS, MOST_SIGNALS, OUTPUT, apply_laws, friction

_V, _M = types.float64[::1], types.float64[:, ::1]
_I, _IV, _IM = types.int64, types.int64[::1], types.int64[:, ::1]
LINEAR, CONTINUOUS, DISCRETE = 0, 1, 2  # kinds of plant: matrices, Python code for dx/dt, Python code for the next state
LIMIT = 1e150  # a state beyond it has diverged


@njit(cache=True, nogil=True, fastmath=True)
def _affine(At, x, Bt, u, out):  # type: ignore[no-untyped-def]
    """Write ``A x + B u`` into ``out``; matrices transposed, so the inner loops run along memory."""
    out[:] = 0.0
    for j in range(x.size):
        xj = x[j]
        for i in range(out.size):
            out[i] += At[j, i] * xj
    for j in range(u.size):
        uj = u[j]
        for i in range(out.size):
            out[i] += Bt[j, i] * uj


@njit(cache=True, nogil=True, fastmath=True)
def _middle(phih, x, gamh, ue, rows, base, s):  # type: ignore[no-untyped-def]
    """Predict the states ``rows`` half a step ahead, into the signals."""
    for i in rows:
        a = 0.0
        for j in range(x.size):
            a += phih[i, j] * x[j]
        for j in range(ue.size):
            a += gamh[i, j] * ue[j]
        s[base + i] = a


@njit(cache=True, nogil=True, fastmath=True)
def _between(U, k, w, out):  # type: ignore[no-untyped-def]
    """Write the cubic through four samples around ``k``, at ``w`` of the way from sample k to k + 1."""
    N = U.shape[0]
    a, b, c = max(k - 1, 0), min(k + 1, N - 1), min(k + 2, N - 1)
    l0 = -w * (w - 1) * (w - 2) / 6
    l1 = (w + 1) * (w - 1) * (w - 2) / 2
    l2 = -(w + 1) * w * (w - 2) / 2
    l3 = (w + 1) * w * (w - 1) / 6
    for j in range(out.size):
        out[j] = l0 * U[a, j] + l1 * U[k, j] + l2 * U[b, j] + l3 * U[c, j]


@njit(cache=True, nogil=True)
def _call(function, t, x, u, values, out):  # type: ignore[no-untyped-def]
    """Call Python code by its address."""
    call_dynamics(function, t, x.ctypes.data, u.ctypes.data, values.ctypes.data, out.ctypes.data)  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def _runge_kutta(rate, t, h, x, u, values, f, k1, ks, xs, new):  # type: ignore[no-untyped-def]
    """Write the state after ``h`` into ``new``: ``dx/dt = rate + f``; ``k1`` is the rate at the start, without ``f``."""
    for i in range(x.size):
        new[i] = x[i] + h / 6 * (k1[i] + f[i])
        xs[i] = x[i] + h / 2 * (k1[i] + f[i])
    for stage in range(3):
        ahead = h if stage == 2 else h / 2
        _call(rate, t + ahead, xs, u, values, ks)
        weight = h / 6 if stage == 2 else h / 3
        ahead = h / 2 if stage == 0 else h
        for i in range(x.size):
            new[i] += weight * (ks[i] + f[i])
            xs[i] = x[i] + ahead * (ks[i] + f[i])


@njit(
    types.void(
        types.boolean, types.boolean, types.boolean, _I, types.float64, types.float64, _M, _M, _M, _M, _M, _M, _M, _M, _IV, _IV,
        _I, _I, _I, _V,
        _M, _M, _M, _M, _M, _M, _M, _M, _V,
        *[FunctionType(LAW)] * MOST_EFFECTS,
        _IM, _M, _V,
        _M, _M, _M,
    ),
    cache=True, nogil=True,
)
def simulate(  # type: ignore[no-untyped-def]  # noqa: C901, PLR0915 - one compiled loop over samples
    closed, ramped, direct, nsub, dt, t0, phi, gam, gx, phih, gamh, C, D, Kp, forced, middle,
    kind, rate, output, values,
    KA, KB, KC, KD, U, Y, R, AUX, x0,
    law0, law1, law2, law3, law4, law5, law6, law7, plan, par, mem,
    yhat, uhat, xhat,
):
    """Fill ``yhat (n, p)``, ``uhat (n, m)`` (the input before effects) and ``xhat (n, states)``.

    Open: ``U (n, m)`` is the measured input. Closed: ``u = K (yhat - R) + U`` with ``U`` what was added to the controller's
    output. Samples where Y is not finite correct nothing. ``ramped`` (open only) takes the input to run smoothly from sample
    to sample instead of being held; input laws then see no states. ``direct``: the input reaches the output at once.
    """
    laws = (law0, law1, law2, law3, law4, law5, law6, law7)
    N, p = Y.shape
    n, m, na, nk = x0.size, U.shape[1], AUX.shape[1], KA.shape[0]
    h = dt / nsub
    x, new, f = x0.copy(), np.zeros(n), np.zeros(n)
    k1, ks, xs = np.zeros(n), np.zeros(n), np.zeros(n)
    xk, knew, e = np.zeros(nk), np.zeros(nk), np.zeros(p)
    u, ue, held, y = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(p)
    mean = np.zeros(m)
    s, work, first = np.zeros(m + n + p + na + 1), np.zeros(2 * MOST_SIGNALS), np.zeros(MOST_SIGNALS)
    it = m + n + p + na
    phit, gamt, gxt, ct, dtr, kt = phi.T.copy(), gam.T.copy(), gx.T.copy(), C.T.copy(), D.T.copy(), Kp.T.copy()
    KAt, KBt, KCt, KDt = KA.T.copy(), KB.T.copy(), KC.T.copy(), KD.T.copy()
    corrected = 0 if closed or not np.any(Kp) else p
    shaped, observed, rubbed = False, False, False
    for i in range(plan.shape[0]):
        shaped = shaped or plan[i, 0] == INPUT
        observed = observed or plan[i, 0] == OUTPUT
        rubbed = rubbed or plan[i, 0] == FRICTION
    smooth = U.copy() if ramped else U
    if ramped and shaped:
        for k in range(N):
            s[it] = t0 + k * dt
            for j in range(na):
                s[m + n + p + j] = AUX[k, j]
            for j in range(m):
                s[j] = smooth[k, j]
            apply_laws(INPUT, laws, plan, par, mem, s, work, dt, smooth[k], 0)
    for k in range(N):
        s[it] = t0 + k * dt
        for j in range(na):
            s[m + n + p + j] = AUX[k, j]
        for j in range(n):
            s[m + j] = x[j]
        if ramped:
            for j in range(m):
                ue[j] = smooth[k, j]
        elif direct and not closed:
            for j in range(m):
                u[j] = U[k, j]
                ue[j] = u[j]
                s[j] = u[j]
            if shaped:
                apply_laws(INPUT, laws, plan, par, mem, s, work, h, ue, 0)
        if kind == LINEAR:
            _affine(ct, x, dtr, ue, y)
        else:
            for j in range(n):
                xs[j] = x[j]
            _call(output, s[it], xs, ue, values, y)
        for j in range(p):
            s[m + n + j] = y[j]
        if observed:
            for j in range(m):
                s[j] = held[j]
            apply_laws(OUTPUT, laws, plan, par, mem, s, work, dt, y, m + n)
        if closed:
            for j in range(p):
                e[j] = y[j] - R[k, j]
            _affine(KCt, xk, KDt, e, u)
            _affine(KAt, xk, KBt, e, knew)
            xk[:] = knew
        if not ramped and (closed or not direct):
            for j in range(m):
                u[j] = U[k, j] + (u[j] if closed else 0.0)
                ue[j] = u[j]
                s[j] = u[j]
            if shaped:
                apply_laws(INPUT, laws, plan, par, mem, s, work, h, ue, 0)
        for j in range(p):
            yhat[k, j] = y[j]
        for j in range(m):
            uhat[k, j] = u[j] if closed else U[k, j]
            mean[j] = ue[j]
            s[j] = ue[j]
        for i in range(n):
            xhat[k, i] = x[i]
        for sub in range(nsub):
            if ramped:
                _between(smooth, k, (sub + 0.5) / nsub, mean)
                for j in range(m):
                    s[j] = mean[j]
            elif shaped and sub > 0:
                for j in range(m):
                    mean[j] = u[j]
                    s[j] = u[j]
                apply_laws(INPUT, laws, plan, par, mem, s, work, h, mean, 0)
            for j in forced:
                f[j] = 0.0
            if kind == LINEAR:
                _affine(phit, x, gamt, mean, new)
                _middle(phih, x, gamh, mean, middle, m, s)
            elif kind == DISCRETE:
                for i in range(n):
                    xs[i] = x[i]
                _call(rate, s[it], xs, mean, values, new)
                for i in range(n):
                    s[m + i] = (x[i] + new[i]) / 2
            else:
                for i in range(n):
                    xs[i] = x[i]
                _call(rate, s[it], xs, mean, values, k1)
                for i in range(n):
                    s[m + i] = x[i] + h / 2 * k1[i]
            if forced.size:
                apply_laws(FORCE, laws, plan, par, mem, s, work, h, f, -1)
            if kind == CONTINUOUS:
                _runge_kutta(rate, s[it], h, x, mean, values, f, k1, ks, xs, new)
            else:
                for j in forced:
                    for i in range(n):
                        new[i] += gxt[j, i] * f[j]
            if rubbed:
                friction(laws, plan, par, mem, s, work, h, m, x, new, gxt, first)
            for j in range(n):
                x[j] = new[j]
            s[it] += h
        for j in range(m):
            held[j] = mean[j]
        if corrected:
            for j in range(p):
                d = Y[k, j] - y[j]
                if np.isfinite(d):
                    for i in range(n):
                        x[i] += kt[j, i] * d
        for i in range(n):
            if not (-LIMIT < x[i] < LIMIT):
                yhat[k:, :] = np.nan
                return
