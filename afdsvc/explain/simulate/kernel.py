"""The compiled simulation: a plant with effects at its inputs, forces, outputs and parameters, in or out of its loop.

A linear plant is advanced exactly (matrix exponentials), Python code by the classical Runge-Kutta method of order four. Forces
of effects are evaluated at the predicted middle of the sub-step and held over it, an error of second order; friction, which
is nearly a jump, is implicit (`_friction`). Inputs are held between samples; what effects make of them is worked out in
every sub-step. Parameters of Python code that effects change are worked out once per sample. With a gain ``Kp`` the states are corrected by ``y - yhat`` at every sample, which makes the residual that
of a one-step predictor; in the loop (``closed``) the simulated output feeds the controller and nothing is corrected.

All compiled code is in this file because numba keeps what it compiled until the text of the file of the outermost function
changes; a change elsewhere would go unnoticed.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

_V, _M = types.float64[::1], types.float64[:, ::1]
_I, _IV, _IM = types.int64, types.int64[::1], types.int64[:, ::1]
LINEAR, CONTINUOUS, DISCRETE = 0, 1, 2  # kinds of plant: matrices, Python code for dx/dt, Python code for the next state
DEGREE = 3  # of the polynomials by which an input runs smoothly between samples
LIMIT = 1e150  # a state beyond it has diverged

NUMBERS = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
DYNAMICS = types.void(types.float64, NUMBERS, NUMBERS, NUMBERS, NUMBERS)  # t, x, u, p, out
LAW = types.void(  # parameters, signals, memory, time step, what it adds: addresses and lengths
    NUMBERS, types.intp, NUMBERS, types.intp, NUMBERS, types.intp, types.float64, NUMBERS, types.intp
)
MOST_SIGNALS = 16
READS = 6  # columns of a plan: stage, reads, writes, parameters, memory from, memory to, then addresses
INPUT, FORCE, OUTPUT, FRICTION, RECORDED, PARAMETER = 0, 1, 2, 3, 4, 5  # RECORDED: changes of the measured input that come before all others
AHEAD = 7  # samples of the measured input that such a law may read from the future
IMPLICIT = 0.75  # point of the sub-step where friction is evaluated: 0.5 would chatter at rest, 1 switches late at reversals
SHARP = 0.001  # share of the sub-step that an implicit law gets as dt: it need not be smooth over the whole
CLOSE = 1e-6  # error of an implicit force, over the force, before the last secant
PASSES = 40  # most evaluations of a friction law in one sub-step

_inlined = njit(cache=True, nogil=True, error_model="numpy", inline="always")
_called = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)  # type: ignore[call-overload]  # the caller holds all arrays; counting references takes longer than the rest


@intrinsic
def _address(typingctx, array):  # type: ignore[no-untyped-def]
    """Return the address of an array's first number."""

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        made = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.ptrtoint(made.data, context.get_value_type(types.intp))

    return types.intp(array), build


@intrinsic
def _call(typingctx, function, arguments):  # type: ignore[no-untyped-def]
    """Call compiled code by its address with a tuple of numbers and addresses."""

    def build(context, builder, signature, given):  # type: ignore[no-untyped-def]
        values = cgutils.unpack_tuple(builder, given[1])  # type: ignore[no-untyped-call]
        kind = ir.FunctionType(ir.VoidType(), [v.type for v in values])
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), values)
        return context.get_dummy_value()

    return types.void(types.int64, arguments), build


@_inlined
def _evaluate(i, laws, plan, par, mem, work, dt):  # type: ignore[no-untyped-def]
    """Call law ``i`` on the signals at the start of ``work``; what it adds is left from `MOST_SIGNALS` on."""
    nwrite = plan[i, 2]
    for k in range(MOST_SIGNALS, MOST_SIGNALS + nwrite):
        work[k] = 0.0
    values, memory, z = _address(par) + 8 * i * par.shape[1], _address(mem) + 8 * plan[i, 4], _address(work)  # type: ignore[call-arg, var-annotated]
    _call(laws[i], (values, plan[i, 3], z, plan[i, 1], memory, plan[i, 5] - plan[i, 4], dt, z + 8 * MOST_SIGNALS, nwrite))


@_called
def _apply(stage, laws, plan, par, mem, s, work, dt, target, base):  # type: ignore[no-untyped-def]
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


@_called
def _recorded(laws, plan, par, mem, s, work, dt, k, U, u, it):  # type: ignore[no-untyped-def]
    """Apply what changes the measured input of sample ``k``, held in ``u`` and at the start of ``s``; the samples to come follow the time in ``s``."""
    N, m = U.shape
    for a in range(AHEAD):
        for j in range(m):
            s[it + 1 + a * m + j] = U[min(k + 1 + a, N - 1), j]
    _apply(RECORDED, laws, plan, par, mem, s, work, dt, u, 0)


@_inlined
def _push(column, force, gx, dt, push):  # type: ignore[no-untyped-def]
    """Add a force to ``push``, the rates of the states; columns beyond the last state are forces along signals."""
    if column < push.size:
        push[column] += force
    else:
        for i in range(push.size):
            push[i] += force * gx[i, column] / dt


@_called
def _friction(laws, plan, par, mem, s, work, dt, base, x, new, gx, first, last, push):  # type: ignore[no-untyped-def]  # noqa: C901
    """Add friction to ``new``, the states at the end of the sub-step without it.

    The force ``f = law(x + 0.75 (x+ - x))`` acts over the sub-step and depends on the state ``x+`` it leads to. It is ``r`` times
    the force ``first`` that would act without it, ``r`` in [0, 1] found by secants inside a bracket, beginning at the ``last``
    force and slope of the law. At rest it balances the other forces, so an axis sticks; a third of what remains of the motion is
    left after every sub-step. A law that drives motion acts as at ``r = 1``. The forces are added to ``push``.
    """
    for i in range(plan.shape[0]):
        if plan[i, 0] != FRICTION:
            continue
        r, low, high, size = 0.0, 0.0, 2.0, 0.0
        before, excess_before = 0.0, 1.0
        for k in range(plan[i, 2]):
            first[k] = 0.0
        for turn in range(PASSES):
            for k in range(plan[i, 1]):
                work[k] = s[plan[i, READS + k]]
                j = plan[i, READS + k] - base
                if 0 <= j < x.size:
                    end = new[j]
                    for q in range(plan[i, 2]):
                        end += r * first[q] * gx[j, plan[i, READS + MOST_SIGNALS + q]]
                    work[k] = x[j] + IMPLICIT * (end - x[j])
            _evaluate(i, laws, plan, par, mem, work, SHARP * dt)
            if turn == 0:
                for q in range(plan[i, 2]):
                    first[q] = work[MOST_SIGNALS + q]
                    size += first[q] * first[q]
                if size == 0.0:
                    break
                r = last[i, 0] / first[0] if first[0] != 0.0 else 1.0
                if not 0.0 < r < 1.0:
                    r = 1.0
                continue
            excess = -r
            for q in range(plan[i, 2]):
                excess += first[q] * work[MOST_SIGNALS + q] / size
            if r == 1.0 and excess > -CLOSE:
                r = min(1.0 + excess, 1.5)
                break
            if turn > 1:
                last[i, 1] = (excess - excess_before) / (r - before)
            following = r - excess / last[i, 1]
            if abs(excess) < CLOSE:
                r = following
                break
            if excess > 0.0:
                low = r
            else:
                high = r
            if turn % 4 == 0 or not low < following < high:
                following = 0.5 * (low + high)
            before, excess_before, r = r, excess, min(following, 1.0)
        last[i, 0] = r * first[0]
        for q in range(plan[i, 2]):
            _push(plan[i, READS + MOST_SIGNALS + q], r * first[q], gx, dt, push)
            for j in range(x.size):
                new[j] += r * first[q] * gx[j, plan[i, READS + MOST_SIGNALS + q]]


@_inlined
def _affine(A, x, B, u, out):  # type: ignore[no-untyped-def]
    """Write ``A x + B u`` into ``out``."""
    for i in range(out.size):
        a = 0.0
        for j in range(x.size):
            a += A[i, j] * x[j]
        for j in range(u.size):
            a += B[i, j] * u[j]
        out[i] = a


@_inlined
def _middle(phih, x, gamh, ue, rows, base, s):  # type: ignore[no-untyped-def]
    """Predict the states ``rows`` half a step ahead, into the signals."""
    for k in range(rows.size):
        i = rows[k]
        a = 0.0
        for j in range(x.size):
            a += phih[i, j] * x[j]
        for j in range(ue.size):
            a += gamh[i, j] * ue[j]
        s[base + i] = a


@_called
def _between(U, k, w, share, out, middle):  # type: ignore[no-untyped-def]
    """Write the cubic through four samples around ``k`` from ``w`` of the way to sample k + 1 on: its coefficients in shares of the
    interval, constant first, and its value half a share later."""
    N, m = U.shape
    before, after, second = max(k - 1, 0), min(k + 1, N - 1), min(k + 2, N - 1)
    for j in range(m):
        a, b, c, d = U[before, j], U[k, j], U[after, j], U[second, j]
        c1, c2, c3 = c - a / 3 - b / 2 - d / 6, (a + c) / 2 - b, (d - a) / 6 + (b - c) / 2
        out[j] = b + w * (c1 + w * (c2 + w * c3))
        out[m + j] = share * (c1 + w * (2 * c2 + w * 3 * c3))
        out[2 * m + j] = share * share * (c2 + 3 * w * c3)
        out[3 * m + j] = share * share * share * c3
        middle[j] = out[j] + (out[m + j] + (out[2 * m + j] + out[3 * m + j] / 2) / 2) / 2


@_called
def _python(function, t, x, u, values, out):  # type: ignore[no-untyped-def]
    """Call Python code by its address."""
    _call(function, (t, _address(x), _address(u), _address(values), _address(out)))  # type: ignore[call-arg]


@njit(types.void(_I, _M, _M, _V, types.float64[:, :, ::1]), cache=True, nogil=True, error_model="numpy")
def slopes(function, at, inputs, values, out):  # type: ignore[no-untyped-def]
    """Write the derivatives of Python code at some states and inputs, ``(points, values, n or n + m)``: with respect to the state, and to the input
    where there is room; central differences, 0 where there is no finite slope."""
    n = at.shape[1]
    x, u = np.zeros(n), np.zeros(inputs.shape[1])
    ahead, behind = np.zeros(out.shape[1]), np.zeros(out.shape[1])
    for k in range(at.shape[0]):
        x[:], u[:] = at[k], inputs[k]
        for j in range(out.shape[2]):
            moved, i = (x, j) if j < n else (u, j - n)
            here = moved[i]
            step = 1e-6 * max(1.0, abs(here))
            moved[i] = here + step
            _python(function, 0.0, x, u, values, ahead)
            moved[i] = here - step
            _python(function, 0.0, x, u, values, behind)
            moved[i] = here
            for row in range(ahead.size):
                slope = (ahead[row] - behind[row]) / (2 * step)
                out[k, row, j] = slope if np.isfinite(slope) else 0.0


@_called
def _along(rate, t, h, x, u, values, k1, along, ks, f, gx):  # type: ignore[no-untyped-def]
    """Add forces that act along an input to ``f``: as the rates follow the input here; ``along (E, 2)`` are inputs and gains, ``k1`` the rates.

    Their columns are the last of ``gx``; where the rates do not follow the input, as where code limits it, they stay as they were.
    """
    n = x.size
    for e in range(along.shape[0]):
        j = int(along[e, 0])
        here, step, moved = u[j], 1e-4 * max(1.0, abs(u[j])), 0.0
        u[j] = here + step
        _python(rate, t, x, u, values, ks)
        u[j] = here
        for q in range(n):
            moved += abs(ks[q] - k1[q])
        for q in range(n):
            if 0.0 < moved < LIMIT:
                gx[q, n + e] = h * (ks[q] - k1[q]) / (step * along[e, 1])
            f[q] += f[n + e] * gx[q, n + e] / h


@_called
def _runge_kutta(rate, t, h, x, u, values, f, k1, ks, xs, new):  # type: ignore[no-untyped-def]
    """Write the state after ``h`` into ``new``: ``dx/dt = rate + f``; ``k1`` is the rate at the start, without ``f``."""
    for i in range(x.size):
        new[i] = x[i] + h / 6 * (k1[i] + f[i])
        xs[i] = x[i] + h / 2 * (k1[i] + f[i])
    for stage in range(3):
        ahead = h if stage == 2 else h / 2
        _python(rate, t + ahead, xs, u, values, ks)
        weight = h / 6 if stage == 2 else h / 3
        ahead = h / 2 if stage == 0 else h
        for i in range(x.size):
            new[i] += weight * (ks[i] + f[i])
            xs[i] = x[i] + ahead * (ks[i] + f[i])


@njit(
    types.void(
        types.boolean, types.boolean, types.boolean, _I, types.float64, types.float64, _M, _M, _M, _M, _M, _M, _M, _M, _M, _IV, _IV,
        _I, _I, _I, _V,
        _M, _M, _M, _M, _M, _M, _M, _M, _V,
        _IV, _IM, _M, _V, _M,
        _M, _M, _M,
    ),
    cache=True, nogil=True, error_model="numpy",
)
def simulate_compiled(  # type: ignore[no-untyped-def]  # noqa: C901, PLR0915 - one compiled loop over samples
    closed, ramped, direct, nsub, dt, t0, phi, gam, gx, phih, gamh, C, D, felt, Kp, forced, middle,
    kind, rate, output, values,
    KA, KB, KC, KD, U, Y, R, AUX, x0,
    laws, plan, par, mem, along,
    yhat, uhat, xhat,
):
    """Fill ``yhat (n, p)``, ``uhat (n, m)`` (the input before effects) and ``xhat (n, states)``.

    ``values`` are the parameters of Python code, left as effects changed them last. Open: ``U (n, m)`` is the measured input. Closed: ``u = K (yhat - R) + U`` with ``U`` what was added to the controller's
    output. ``laws`` holds the addresses of the compiled laws. Samples where Y is not finite correct nothing. ``ramped`` (open only)
    takes the input to run smoothly from sample to sample instead of being held, ``gam`` and ``gamh`` its coefficients; what input
    laws add to it from the first on that reads states or outputs is held over every sub-step. ``along (E, 2)`` are the signals that forces act along, and the gains by which their sizes are those of the signals: they are
    written to states beyond the last, and their columns of ``gx (n, n + E)`` follow code. ``direct``: the input reaches the output at once. Outputs feel
    ``felt (p, n)`` of the forces of effects at once: half of the one before the sample and half of the one after. Where ``xhat`` has no rows only outputs are kept.
    """
    N, p = Y.shape
    kept = xhat.shape[0] > 0
    n, m, na, nk = x0.size, U.shape[1], AUX.shape[1], KA.shape[0]
    h = dt / nsub
    x, new, f = x0.copy(), np.zeros(n), np.zeros(n + along.shape[0])
    k1, ks, xs = np.zeros(n), np.zeros(n), np.zeros(n)
    push, before, sensed = np.zeros(n), np.zeros(n), bool(np.any(felt))
    xk, knew, e = np.zeros(nk), np.zeros(nk), np.zeros(p)
    u, ue, held, y = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(p)
    mean, added = np.zeros(m), np.zeros(m)
    drive = np.zeros((DEGREE + 1) * m) if ramped else mean
    it, ip = m + n + p + na, m + n + p + na + 1 + AHEAD * m
    s, work, first = np.zeros(ip + values.size), np.zeros(2 * MOST_SIGNALS), np.zeros(MOST_SIGNALS)
    last, stated = -np.ones((plan.shape[0], 2)), values.copy()
    corrected = 0 if closed or not np.any(Kp) else p
    shaped, observed, rubbed, led, varied = False, False, False, False, False
    early = plan.shape[0]  # effects before the first at an input that the measured input and time do not settle
    for i in range(plan.shape[0]):
        for r in range(plan[i, 1] if plan[i, 0] == INPUT else 0):
            if m <= plan[i, READS + r] < m + n + p:
                early = min(early, i)
        shaped = shaped or plan[i, 0] == INPUT
        observed = observed or plan[i, 0] == OUTPUT
        rubbed = rubbed or plan[i, 0] == FRICTION
        varied = varied or plan[i, 0] == PARAMETER
        led = led or (plan[i, 0] == RECORDED and not closed)
    smooth = U.copy() if ramped else U
    if ramped and (shaped or led):
        for k in range(N):
            s[it] = t0 + k * dt
            for j in range(na):
                s[m + n + p + j] = AUX[k, j]
            for j in range(m):
                s[j] = smooth[k, j]
            if led:
                _recorded(laws, plan, par, mem, s, work, dt, k, U, smooth[k], it)
            _apply(INPUT, laws[:early], plan[:early], par[:early], mem, s, work, dt, smooth[k], 0)
    for k in range(N):
        s[it] = t0 + k * dt
        for j in range(na):
            s[m + n + p + j] = AUX[k, j]
        for j in range(n):
            s[m + j] = x[j]
        if varied:
            values[:] = stated
            s[ip:] = stated
            _apply(PARAMETER, laws, plan, par, mem, s, work, dt, values, ip)
        if ramped:
            for j in range(m):
                ue[j] = smooth[k, j] + added[j]
        elif direct and not closed:
            for j in range(m):
                u[j] = U[k, j]
                s[j] = u[j]
            if led:
                _recorded(laws, plan, par, mem, s, work, dt, k, U, u, it)
            for j in range(m):
                ue[j] = u[j]
            if shaped:
                _apply(INPUT, laws, plan, par, mem, s, work, h, ue, 0)
        if kind == LINEAR:
            _affine(C, x, D, ue, y)
        else:
            for j in range(n):
                xs[j] = x[j]
            _python(output, s[it], xs, ue, values, y)
        for j in range(p):
            for i in range(n if sensed else 0):
                y[j] += felt[j, i] * before[i]
            s[m + n + j] = y[j]
        if observed:
            for j in range(m):
                s[j] = held[j]
            _apply(OUTPUT, laws, plan, par, mem, s, work, dt, y, m + n)
        if closed:
            for j in range(p):
                e[j] = y[j] - R[k, j]
            _affine(KC, xk, KD, e, u)
            _affine(KA, xk, KB, e, knew)
            xk[:] = knew
        if not ramped and (closed or not direct):
            for j in range(m):
                u[j] = U[k, j] + (u[j] if closed else 0.0)
                s[j] = u[j]
            if led:
                _recorded(laws, plan, par, mem, s, work, dt, k, U, u, it)
            for j in range(m):
                ue[j] = u[j]
            if shaped:
                _apply(INPUT, laws, plan, par, mem, s, work, h, ue, 0)
        for j in range(p):
            yhat[k, j] = y[j]
        for j in range(m):
            mean[j] = ue[j]
            s[j] = ue[j]
        if kept:
            for j in range(m):
                uhat[k, j] = u[j] if closed else U[k, j]
            for i in range(n):
                xhat[k, i] = x[i]
        for sub in range(nsub):
            if ramped:
                _between(smooth, k, sub / nsub, 1 / nsub, drive, mean)
                s[:m] = mean
                if early < plan.shape[0]:
                    added[:] = -mean
                    s[m : m + n] = x
                    _apply(INPUT, laws[early:], plan[early:], par[early:], mem, s, work, h, mean, 0)
                    added += mean
                    drive[:m] += added
            elif shaped and sub > 0:
                mean[:] = u
                s[:m] = u
                s[m : m + n] = x
                _apply(INPUT, laws, plan, par, mem, s, work, h, mean, 0)
            f[:] = 0.0
            if kind == LINEAR:
                _affine(phi, x, gam, drive, new)
                _middle(phih, x, gamh, drive, middle, m, s)
            elif kind == DISCRETE:
                for i in range(n):
                    xs[i] = x[i]
                _python(rate, s[it], xs, mean, values, new)
                for i in range(n):
                    s[m + i] = (x[i] + new[i]) / 2
            else:
                for i in range(n):
                    xs[i] = x[i]
                _python(rate, s[it], xs, mean, values, k1)
                for i in range(n):
                    s[m + i] = x[i] + h / 2 * k1[i]
            if forced.size:
                _apply(FORCE, laws, plan, par, mem, s, work, h, f, -1)
            if kind == CONTINUOUS:
                _along(rate, s[it], h, xs, mean, values, k1, along, ks, f, gx)
                _runge_kutta(rate, s[it], h, x, mean, values, f, k1, ks, xs, new)
            else:
                for j in range(forced.size):
                    for i in range(n):
                        new[i] += gx[i, forced[j]] * f[forced[j]]
            if sensed:
                push[:] = f[:n]
                for j in range(forced.size):
                    if forced[j] >= n and kind != CONTINUOUS:
                        _push(forced[j], f[forced[j]], gx, h, push)
            if rubbed:
                _friction(laws, plan, par, mem, s, work, h, m, x, new, gx, first, last, push)
            if sensed:
                if sub == 0:
                    for j in range(p):
                        for i in range(n):
                            y[j] += (0.5 if k > 0 else 1.0) * felt[j, i] * (push[i] - before[i])
                        yhat[k, j] = y[j]
                before[:] = push
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
                        x[i] += Kp[i, j] * d
        for i in range(n):
            if not (-LIMIT < x[i] < LIMIT):
                yhat[k:, :] = np.nan
                return
