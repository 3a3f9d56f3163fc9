"""The control sample: the one place where a controller in J_K form meets its limits, compiled.

`control_sample` is called once per sample by the loop around real hardware, and `run_closed_loop` runs it against a linear
plant for a slice of samples; both therefore enforce the limits in the same way, inside the sample.

Beside J_K runs Q (`afdsvc.hal.excitation`), from beta to alpha through a gain between 0 and 1. What it adds to alpha is not counted as
excitation: ``alpha`` stays the burst. ``motion`` holds how the gain moves: ``[phase, rise, fall, direction]`` with the gain
``(1 - cos(pi phase)) / 2``, the steps of the phase per sample, and 1 while Q is to act, -1 while it is to go, 0 without one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from afdsvc.lti.statespace import Array, StateSpace

NO_CAUSE, OUTPUT_LIMIT, INPUT_LIMIT, BAD_SAMPLE, RESET = 0, 1, 2, 3, 4


@njit(cache=True)
def control_sample(A, B, C, D, xk, q, motion, y, alpha, armed, output_limit, input_limit, u, beta):  # type: ignore[no-untyped-def]
    """Advance J_K and Q by one sample and return why excitation and Q must end (`NO_CAUSE` when they may go on).

    Writes the plant input ``u (m,)`` and the residual ``beta (p,)``, advances ``xk`` and the state of ``q = (A, B, C, D, x)`` in place.
    When a limit is met while ``armed`` or while Q acts, ``alpha`` is zeroed in place and the gain of Q falls, beginning in this very
    sample; a fall of one sample is over in it. ``u`` is always finite and inside ``input_limit``. A
    sample with NaN in y leaves the controller state alone and holds u. A controller whose state or outputs are no longer
    finite is reset: state, u and alpha become zero and Q is off.
    """
    p, m, nk = y.size, u.size, xk.size
    watched = armed or motion[0] > 0.0 or motion[3] > 0.0
    cause = _judge_outputs(y, watched, output_limit)
    if cause != NO_CAUSE:
        alpha[:] = 0.0
        motion[3] = min(motion[3], -1.0) if watched else motion[3]
    _move(motion, q[4])
    if cause == BAD_SAMPLE:
        beta[:] = np.nan
        return cause
    total = np.empty(m)
    _excite(C, D, xk, y, q, motion, alpha, total, beta, m, p, nk)
    over = _outputs(C, D, xk, y, total, input_limit, u, beta, m, p, nk)
    if over and watched and cause == NO_CAUSE:
        cause = INPUT_LIMIT
        alpha[:] = 0.0
        if motion[3] > 0.0:
            motion[3] = -1.0
            _move(motion, q[4])
        _excite(C, D, xk, y, q, motion, alpha, total, beta, m, p, nk)
        _outputs(C, D, xk, y, total, input_limit, u, beta, m, p, nk)
    _advance(A, B, xk, y, total, m, p, nk)
    if motion[0] > 0.0:
        _advance(q[0], q[1], q[4], beta, total[:0], 0, p, q[4].size)
    if not (_finite(xk) and _finite(beta) and _finite(u) and _finite(q[4])):
        xk[:], u[:], alpha[:], beta[:], q[4][:] = 0.0, 0.0, 0.0, np.nan, 0.0
        motion[0], motion[3] = 0.0, 0.0
        return RESET
    return cause


@njit(cache=True)
def _move(motion, xq):  # type: ignore[no-untyped-def]
    """Advance the phase of the gain; a Q that has come to zero is at rest."""
    if motion[3] > 0.0:
        motion[0] = min(1.0, motion[0] + motion[1])
    elif motion[3] < 0.0:
        motion[0] = max(0.0, motion[0] - motion[2])
        if motion[0] == 0.0:
            motion[3] = 0.0
            xq[:] = 0.0


@njit(cache=True)
def _excite(C, D, xk, y, q, motion, alpha, total, beta, m, p, nk):  # type: ignore[no-untyped-def]
    """Write what enters J_K, ``alpha + gain Q beta``; where Q acts, beta does not depend on alpha in the same sample."""
    total[:] = alpha
    if motion[0] == 0.0:
        return
    gain = 0.5 - 0.5 * np.cos(np.pi * motion[0])
    for i in range(p):
        s = 0.0
        for j in range(nk):
            s += C[m + i, j] * xk[j]
        for j in range(p):
            s += D[m + i, j] * y[j]
        beta[i] = s
    for i in range(m):
        s = 0.0
        for j in range(q[4].size):
            s += q[2][i, j] * q[4][j]
        for j in range(p):
            s += q[3][i, j] * beta[j]
        total[i] += gain * s


@njit(cache=True)
def plausible(y, bound):  # type: ignore[no-untyped-def]
    """Return the readings ``y (p,)`` with NaN in place of what lies beyond its bound."""
    out = np.empty(y.size)
    for i in range(y.size):
        out[i] = y[i] if abs(y[i]) <= bound[i] else np.nan
    return out


@njit(cache=True)
def _finite(values):  # type: ignore[no-untyped-def]
    """Return whether all values are finite."""
    for value in values:
        if not np.isfinite(value):
            return False
    return True


@njit(cache=True)
def _judge_outputs(y, armed, output_limit):  # type: ignore[no-untyped-def]
    """Return why the outputs alone end an excitation."""
    cause = NO_CAUSE
    for i in range(y.size):
        if not np.isfinite(y[i]):
            return BAD_SAMPLE
        if armed and not abs(y[i]) <= output_limit[i]:
            cause = OUTPUT_LIMIT
    return cause


@njit(cache=True)
def _advance(A, B, xk, y, alpha, m, p, nk):  # type: ignore[no-untyped-def]
    """Advance the controller's state in place."""
    new = np.zeros(nk)
    for i in range(nk):
        s = 0.0
        for j in range(nk):
            s += A[i, j] * xk[j]
        for j in range(p):
            s += B[i, j] * y[j]
        for j in range(m):
            s += B[i, p + j] * alpha[j]
        new[i] = s
    xk[:] = new


@njit(cache=True)
def _outputs(C, D, xk, y, alpha, input_limit, u, beta, m, p, nk):  # type: ignore[no-untyped-def]
    """Write u (clipped to its limit) and beta; return whether u had to be clipped."""
    over = False
    for i in range(m + p):
        s = 0.0
        for j in range(nk):
            s += C[i, j] * xk[j]
        for j in range(p):
            s += D[i, j] * y[j]
        for j in range(m):
            s += D[i, p + j] * alpha[j]
        if i >= m:
            beta[i - m] = s
        elif not abs(s) <= input_limit[i]:  # true for NaN too, which `np.sign` passes on: the caller resets
            over = True
            u[i] = np.sign(s) * input_limit[i]
        else:
            u[i] = s
    return over


@njit(cache=True)
def _multiply(columns, x, out):  # type: ignore[no-untyped-def]
    """Write ``A x`` into ``out`` from the columns of A, every sum in the order of a loop over rows.

    Column by column the inner loop has no sum to carry and runs four times as fast for hundreds of states.
    """
    out[:] = 0.0
    for j in range(x.size):
        column, value = columns[j], x[j]
        for i in range(out.size):
            out[i] += column[i] * value


@njit(cache=True)
def run_closed_loop(  # type: ignore[no-untyped-def]
    A, B, C, x, KA, KB, KC, KD, xk, q, motion, alpha, disturbance, noise, armed, output_limit, input_limit, u_hold, u, y, beta
):
    """Run plant, controller and Q for the samples of ``alpha (n, m)``; return (cause, index of the sample it fell in).

    The plant is ``x+ = A x + B (u + disturbance), y = C x + noise`` (``disturbance (n, m)``, ``noise (n, p)``). From the sample
    a limit was met on, alpha is zero. ``x``, ``xk``, ``u_hold`` and ``alpha`` change in place; u, y, beta are filled.
    """
    n, m = alpha.shape
    p, nx = noise.shape[1], x.size
    cause, at = NO_CAUSE, -1
    new, columns = np.zeros(nx), np.ascontiguousarray(A.T)
    yk, bk = np.zeros(p), np.zeros(p)
    for k in range(n):
        for i in range(p):
            s = noise[k, i]
            for j in range(nx):
                s += C[i, j] * x[j]
            yk[i] = s
        if cause != NO_CAUSE:
            alpha[k, :] = 0.0
        watched = armed or motion[0] > 0.0 or motion[3] > 0.0
        found = control_sample(
            KA, KB, KC, KD, xk, q, motion, yk, alpha[k], armed and cause == NO_CAUSE, output_limit, input_limit, u_hold, bk
        )
        if watched and found != NO_CAUSE and cause == NO_CAUSE:
            cause, at = found, k
        _multiply(columns, x, new)
        for i in range(nx):
            s = new[i]
            for j in range(m):
                s += B[i, j] * (u_hold[j] + disturbance[k, j])
            x[i] = s
        u[k, :] = u_hold
        y[k, :] = yk
        beta[k, :] = bk
    return cause, at


def contiguous_system(system: StateSpace) -> StateSpace:
    """Return the system with its matrices laid out as the compiled loops were compiled for; another layout recompiles."""
    A, B, C, D = (np.ascontiguousarray(M) for M in (system.A, system.B, system.C, system.D))
    return StateSpace(A, B, C, D, system.dt)


def no_q(inputs: int, outputs: int) -> tuple[tuple[Array, Array, Array, Array, Array], Array]:
    """Return ``q`` and ``motion`` of a loop without Q."""
    q = (np.zeros((0, 0)), np.zeros((0, outputs)), np.zeros((inputs, 0)), np.zeros((inputs, outputs)), np.zeros(0))
    return q, np.zeros(4)


def compile_loops() -> None:
    """Compile both loops before the sample clock starts: the first call takes seconds."""
    one, none = np.ones((1, 1)), np.zeros(1)
    jk = one, np.zeros((1, 2)), np.zeros((2, 1)), np.zeros((2, 2)), np.zeros(1), *no_q(1, 1)
    control_sample(*jk, none, none, False, none, none, none, none)
    row = np.zeros((1, 1))
    plausible(none, none)
    run_closed_loop(one, one, one, np.zeros(1), *jk, row, row, row, False, none, none, np.zeros(1), row, row, row)
