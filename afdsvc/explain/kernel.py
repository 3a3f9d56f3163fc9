"""The compiled simulation: a linear plant with effects at its inputs, forces and outputs, in or out of its loop.

The linear part is advanced exactly (matrix exponentials), forces by the exponential midpoint rule: evaluated at the
predicted middle of the step and held over it, an error of second order in step times bandwidth. Inputs are held between
samples; what effects make of them is worked out in every sub-step. With a gain ``Kp`` the states are corrected by ``y - yhat`` at every sample, which makes the residual that of a
one-step predictor; in the loop (``closed``) the simulated output feeds the controller and nothing is corrected.
"""

from __future__ import annotations

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]
from numba.core import cgutils
from numba.core.types import FunctionType
from numba.extending import intrinsic

_V = types.float64[::1]
_M = types.float64[:, ::1]
LAW = types.void(_V, _V, _V, types.float64, _V)
MOST_EFFECTS = 6
MOST_SIGNALS = 16
READS = 7  # columns of a plan: stage, reads, writes, parameters, memory from, memory to, bent, then addresses
INPUT, FORCE, OUTPUT = 0, 1, 2
_I, _IV, _IM = types.int64, types.int64[::1], types.int64[:, ::1]


@intrinsic
def _pointer(typingctx, address):  # type: ignore[no-untyped-def]
    """Return an address as a pointer, so that views of memory can be made without counting references."""

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), build


@njit(cache=True, nogil=True)
def _apply(stage, laws, plan, par, mem, s, work, dt, target, base):  # type: ignore[no-untyped-def]
    """Add to ``target`` what every effect of this stage contributes, given the signals ``s``.

    With ``base >= 0`` the signals from there on are kept equal to the target, so later effects see earlier ones. A bent
    law is multiplied by ``1 + c1 w + c2 w^2``, ``w`` the size of its first signal over a reference (the last parameters).
    """
    for i in range(plan.shape[0]):
        if plan[i, 0] != stage:
            continue
        nread, nwrite = plan[i, 1], plan[i, 2]
        z = carray(_pointer(work.ctypes.data), nread, np.float64)  # type: ignore[call-arg]
        out = carray(_pointer(work.ctypes.data + 8 * MOST_SIGNALS), nwrite, np.float64)
        values = carray(_pointer(par.ctypes.data + 8 * i * par.shape[1]), plan[i, 3], np.float64)
        memory = carray(_pointer(mem.ctypes.data + 8 * plan[i, 4]), plan[i, 5] - plan[i, 4], np.float64)
        for k in range(nread):
            z[k] = s[plan[i, READS + k]]
        for k in range(nwrite):
            out[k] = 0.0
        laws[i](values, z, memory, dt, out)
        factor = 1.0
        if plan[i, 6]:
            w = abs(z[0]) / par[i, par.shape[1] - 1]
            factor += par[i, par.shape[1] - 3] * w + par[i, par.shape[1] - 2] * w * w
        for k in range(nwrite):
            j = plan[i, READS + MOST_SIGNALS + k]
            target[j] += out[k] * factor
            if base >= 0:
                s[base + j] = target[j]


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


@njit(
    types.void(
        types.boolean, types.boolean, _I, types.float64, types.float64, _M, _M, _M, _M, _M, _M, _M, _M, _IV, _IV,
        _M, _M, _M, _M, _M, _M, _M, _M, _V,
        FunctionType(LAW), FunctionType(LAW), FunctionType(LAW), FunctionType(LAW), FunctionType(LAW), FunctionType(LAW),
        _IM, _M, _V,
        _M, _M, _M,
    ),
    cache=True, nogil=True,
)
def simulate_linear(  # type: ignore[no-untyped-def]  # noqa: C901, PLR0915 - one compiled loop over samples
    closed, ramped, nsub, dt, t0, phi, gam, gx, phih, gamh, C, D, Kp, forced, middle,
    KA, KB, KC, KD, U, Y, R, AUX, x0,
    law0, law1, law2, law3, law4, law5, plan, par, mem,
    yhat, uhat, xhat,
):
    """Fill ``yhat (n, p)``, ``uhat (n, m)`` (the input before effects) and ``xhat (n, states)``.

    Open: ``U (n, m)`` is the measured input. Closed: ``u = K (yhat - R) + U`` with ``U`` what was added to the controller's
    output. Samples where Y is not finite correct nothing. ``ramped`` (open only) takes the input to run smoothly from sample
    to sample instead of being held; input laws then see no states.
    """
    laws = (law0, law1, law2, law3, law4, law5)
    N, p = Y.shape
    n, m, na, nk = x0.size, gam.shape[1], AUX.shape[1], KA.shape[0]
    h = dt / nsub
    x, new, f = x0.copy(), np.zeros(n), np.zeros(n)
    xk, knew, e = np.zeros(nk), np.zeros(nk), np.zeros(p)
    u, ue, held, y = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(p)
    mean = np.zeros(m)
    s, work = np.zeros(m + n + p + na + 1), np.zeros(2 * MOST_SIGNALS)
    it = m + n + p + na
    phit, gamt, gxt, ct, dtr, kt = phi.T.copy(), gam.T.copy(), gx.T.copy(), C.T.copy(), D.T.copy(), Kp.T.copy()
    KAt, KBt, KCt, KDt = KA.T.copy(), KB.T.copy(), KC.T.copy(), KD.T.copy()
    corrected = 0 if closed or not np.any(Kp) else p
    direct = not closed and np.any(D != 0)
    shaped, observed = False, False
    for i in range(plan.shape[0]):
        shaped = shaped or plan[i, 0] == INPUT
        observed = observed or plan[i, 0] == OUTPUT
    smooth = U.copy() if ramped else U
    if ramped and shaped:
        for k in range(N):
            s[it] = t0 + k * dt
            for j in range(na):
                s[m + n + p + j] = AUX[k, j]
            for j in range(m):
                s[j] = smooth[k, j]
            _apply(INPUT, laws, plan, par, mem, s, work, dt, smooth[k], 0)
    for k in range(N):
        s[it] = t0 + k * dt
        for j in range(na):
            s[m + n + p + j] = AUX[k, j]
        for j in range(n):
            s[m + j] = x[j]
        if ramped:
            for j in range(m):
                ue[j] = smooth[k, j]
        elif direct:  # the input reaches the output at once, so it comes first; the loop cannot be closed then
            for j in range(m):
                u[j] = U[k, j]
                ue[j] = u[j]
                s[j] = u[j]
            if shaped:
                _apply(INPUT, laws, plan, par, mem, s, work, dt, ue, 0)
        _affine(ct, x, dtr, ue, y)
        for j in range(p):
            s[m + n + j] = y[j]
        if observed:
            for j in range(m):
                s[j] = held[j]
            _apply(OUTPUT, laws, plan, par, mem, s, work, dt, y, m + n)
        if closed:
            for j in range(p):
                e[j] = y[j] - R[k, j]
            _affine(KCt, xk, KDt, e, u)
            _affine(KAt, xk, KBt, e, knew)
            xk[:] = knew
        if not direct and not ramped:
            for j in range(m):
                u[j] = U[k, j] + (u[j] if closed else 0.0)
                ue[j] = u[j]
                s[j] = u[j]
            if shaped and nsub == 1:
                _apply(INPUT, laws, plan, par, mem, s, work, dt, ue, 0)
        for j in range(p):
            yhat[k, j] = y[j]
        for j in range(m):
            uhat[k, j] = U[k, j] if not closed else u[j]
            held[j] = ue[j]
            s[j] = ue[j]
        for i in range(n):
            xhat[k, i] = x[i]
        for sub in range(nsub):
            if ramped:
                _between(smooth, k, (sub + 0.5) / nsub, mean)
                for j in range(m):
                    s[j] = mean[j]
            elif shaped and nsub > 1 and not direct:
                for j in range(m):
                    mean[j] = u[j]
                    s[j] = u[j]
                _apply(INPUT, laws, plan, par, mem, s, work, h, mean, 0)
                for j in range(m):
                    held[j] = mean[j]
            else:
                for j in range(m):
                    mean[j] = ue[j]
            _affine(phit, x, gamt, mean, new)
            if forced.size:
                _middle(phih, x, gamh, mean, middle, m, s)
                for j in forced:
                    f[j] = 0.0
                _apply(FORCE, laws, plan, par, mem, s, work, h, f, -1)
                for j in forced:
                    for i in range(n):
                        new[i] += gxt[j, i] * f[j]
            for j in range(n):
                x[j] = new[j]
            s[it] += h
        if corrected:
            for j in range(p):
                d = Y[k, j] - y[j]
                if np.isfinite(d):
                    for i in range(n):
                        x[i] += kt[j, i] * d
        for i in range(n):
            if not (-1e150 < x[i] < 1e150):
                yhat[k:, :] = np.nan
                return
