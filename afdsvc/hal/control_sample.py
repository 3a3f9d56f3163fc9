"""The control sample: the one place where a controller in J_K form meets its limits, compiled.

`control_sample` is called once per sample by the loop around real hardware, and `closed_loop` runs it against a linear
plant for a slice of samples; both therefore enforce the limits in the same way, inside the sample.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from afdsvc.lti.statespace import StateSpace

NO_CAUSE, OUTPUT_LIMIT, INPUT_LIMIT, BAD_SAMPLE, RESET = 0, 1, 2, 3, 4


@njit(cache=True)
def control_sample(A, B, C, D, xk, y, alpha, armed, output_limit, input_limit, u, beta):  # type: ignore[no-untyped-def]
    """Advance J_K by one sample and return why excitation must end (`NO_CAUSE` when it may go on).

    Writes the plant input ``u (m,)`` and the residual ``beta (p,)``, advances ``xk`` in place, and zeroes ``alpha`` in
    place, in this very sample, when a limit is met while ``armed``. ``u`` is always finite and inside ``input_limit``. A
    sample with NaN in y leaves the controller state alone and holds u. A controller whose state or outputs are no longer
    finite is reset: state, u and alpha become zero.
    """
    p, m, nk = y.size, u.size, xk.size
    cause = _judge_outputs(y, armed, output_limit)
    if cause != NO_CAUSE:
        alpha[:] = 0.0
    if cause == BAD_SAMPLE:
        beta[:] = np.nan
        return cause
    over = _outputs(C, D, xk, y, alpha, input_limit, u, beta, m, p, nk)
    if over and armed and cause == NO_CAUSE:
        cause = INPUT_LIMIT
        alpha[:] = 0.0
        _outputs(C, D, xk, y, alpha, input_limit, u, beta, m, p, nk)
    _advance(A, B, xk, y, alpha, m, p, nk)
    if not (_finite(xk) and _finite(beta) and _finite(u)):
        xk[:], u[:], alpha[:], beta[:] = 0.0, 0.0, 0.0, np.nan
        return RESET
    return cause


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
def closed_loop(  # type: ignore[no-untyped-def]
    A, B, C, x, KA, KB, KC, KD, xk, alpha, disturbance, noise, armed, output_limit, input_limit, u_hold, u, y, beta
):
    """Run plant and controller for the samples of ``alpha (n, m)``; return (cause, index of the sample it fell in).

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
        found = control_sample(
            KA, KB, KC, KD, xk, yk, alpha[k], armed and cause == NO_CAUSE, output_limit, input_limit, u_hold, bk
        )
        if armed and found != NO_CAUSE and cause == NO_CAUSE:
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


def contiguous(system: StateSpace) -> StateSpace:
    """Return the system with its matrices laid out as the compiled loops were compiled for; another layout recompiles."""
    A, B, C, D = (np.ascontiguousarray(M) for M in (system.A, system.B, system.C, system.D))
    return StateSpace(A, B, C, D, system.dt)


def warm_up() -> None:
    """Compile both loops before the sample clock starts: the first call takes seconds."""
    one, none = np.ones((1, 1)), np.zeros(1)
    control_sample(one, np.zeros((1, 2)), np.zeros((2, 1)), np.zeros((2, 2)), none, none, none, False, none, none, none, none)
    closed_loop(
        one,
        one,
        one,
        np.zeros(1),
        one,
        np.zeros((1, 2)),
        np.zeros((2, 1)),
        np.zeros((2, 2)),
        np.zeros(1),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
        False,
        none,
        none,
        np.zeros(1),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
    )
