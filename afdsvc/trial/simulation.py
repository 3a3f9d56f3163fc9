"""One recording before and after it is made: what is played, what happens around it, and what came back.

The loop: a continuous plant with effects, integrated by Runge-Kutta 4 in fixed steps, under a sampled controller.

Every control sample: read the outputs (sensor effects, noise, reading effects), step the controller, hold its command,
integrate ``substeps`` steps. Written apart from the simulator of the product and sharing no code with it.

Arrays are handed on one by one, without tuples or views in the inner loops: that is what keeps them fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effect import Truth, law_tables
from afdsvc.trial.laws import dispatch as d
from afdsvc.trial.laws import scalar as c
from afdsvc.trial.laws.scalar import quantised
from afdsvc.trial.machine import TrialMachine


@numba.njit(cache=True, error_model="numpy")
def _command(code, at, p, offset, n, v, X, dX, aux, m, clock, commit):  # type: ignore[no-untyped-def]
    for e in range(code.size):
        group = code[e] // 10
        if group == c.COMMAND:
            d.on_command(code[e], at[e], p[e], v, aux, clock)
        elif group == c.COMMAND_WITH_MEMORY:
            own = slice(n + offset[e], n + offset[e + 1])
            d.on_command_with_memory(code[e], at[e], p[e], v, X[own], dX[own], m[e], clock, commit)


@numba.njit(cache=True, error_model="numpy")
def _forces(code, at, p, offset, n, v, X, dX, aux, m, clock, commit):  # type: ignore[no-untyped-def]
    for e in range(code.size):
        group = code[e] // 10
        if group == c.AXIS:
            d.on_axis(code[e], at[e], p[e], X, clock, dX)
        elif group == c.AXIS_WITH_MEMORY:
            own = slice(n + offset[e], n + offset[e + 1])
            d.on_axis_with_memory(code[e], at[e], p[e], X, X[own], dX[own], m[e], dX, commit)
        elif group == c.MACHINE:
            d.on_machine(code[e], at[e], p[e], X, v, aux, clock, dX)


@numba.njit(cache=True, error_model="numpy")
def _linear(A, B, v, w, k, X, dX):  # type: ignore[no-untyped-def]
    for i in range(A.shape[0]):
        total = w[k, i]
        for j in range(A.shape[1]):
            total += A[i, j] * X[j]
        for j in range(v.size):
            total += B[i, j] * v[j]
        dX[i] = total


@numba.njit(cache=True, error_model="numpy")
def _ahead(X, h, slope, at):  # type: ignore[no-untyped-def]
    for i in range(X.size):
        at[i] = X[i] + h * slope[i]


@numba.njit(cache=True, error_model="numpy")
def _around(aux, k, share, out):  # type: ignore[no-untyped-def]
    """Fill out with the auxiliary signals a share of the way from sample k to the next."""
    for i in range(out.size):
        out[i] = aux[k, i] + share * (aux[k + 1, i] - aux[k, i])


@numba.njit(cache=True, error_model="numpy")
def _sense(code, at, p, y, aux, m, clock):  # type: ignore[no-untyped-def]
    """Turn the true outputs into what the sensors see, without noise."""
    for e in range(code.size):
        group = code[e] // 10
        if group == c.SENSOR:
            d.on_sensor(code[e], at[e], p[e], y, clock)
        elif group == c.SENSOR_WITH_MEMORY:
            d.on_sensor_with_memory(code[e], at[e], p[e], y, aux, m[e], clock)


@numba.njit(cache=True, error_model="numpy")
def _read(code, at, p, y):  # type: ignore[no-untyped-def]
    for e in range(code.size):
        if code[e] // 10 == c.READING:
            y[at[e, 0]] = quantised(y[at[e, 0]], p[e])


@numba.njit(cache=True, error_model="numpy")
def _control(Ak, Bk, Ck, Dk, xk, after, e, u):  # type: ignore[no-untyped-def]
    """One step of the controller: u from its state and input e, then the state."""
    for i in range(u.size):
        u[i] = 0.0
        for j in range(xk.size):
            u[i] += Ck[i, j] * xk[j]
        for j in range(e.size):
            u[i] += Dk[i, j] * e[j]
    for i in range(xk.size):
        after[i] = 0.0
        for j in range(xk.size):
            after[i] += Ak[i, j] * xk[j]
        for j in range(e.size):
            after[i] += Bk[i, j] * e[j]
    for i in range(xk.size):
        xk[i] = after[i]


@numba.njit(cache=True, error_model="numpy")
def _outputs(C, X, y):  # type: ignore[no-untyped-def]
    for i in range(y.size):
        y[i] = 0.0
        for j in range(C.shape[1]):
            y[i] += C[i, j] * X[j]


@numba.njit(cache=True, error_model="numpy")
def _step(laws, code, at, p, offset, A, B, u, w, k, aux, X, room, m, clock, t, local, share, width):  # type: ignore[no-untyped-def]
    """Advance X over clock[2] seconds from time t; the step begins ``share`` into the sample and is ``width`` of it long.

    Classical Runge-Kutta, slopes at 0, 1/2, 1/2 and 1 of the step, then the laws once more at its end to write memories.
    ``laws``: whether any acts on the command, and whether any acts on the rates (a call for nothing costs as much as the plant).
    ``room``: rows for the place a slope is taken at, the slope, their mean, the auxiliary signals, and the command.
    """
    n, size, h = A.shape[0], X.size, clock[2]
    place, slope, mean, air, v = room[0, :size], room[1, :size], room[2, :size], room[3, : aux.shape[1]], room[4, : u.size]
    mean[:] = 0.0
    reach = 0.0
    for q in range(5 if laws[0] or laws[1] else 4):
        if q < 4:
            _ahead(X, reach * h, slope, place)
        else:
            _ahead(X, h, mean, place)
        clock[0], clock[1] = t + reach * h, local + reach * h
        _around(aux, k, share + reach * width, air)
        v[:] = u
        if laws[0]:
            _command(code, at, p, offset, n, v, place, slope, air, m, clock, q == 4)
        _linear(A, B, v, w, k, place, slope)
        if laws[1]:
            _forces(code, at, p, offset, n, v, place, slope, air, m, clock, q == 4)
        reach = 0.5 if q < 2 else 1.0
        if q < 4:
            _ahead(mean, 1.0 / 6.0 if q == 0 or q == 3 else 1.0 / 3.0, slope, mean)
    _ahead(X, h, mean, X)


@numba.njit(cache=True, error_model="numpy")
def integrate(code, at, p, offset, A, B, C, Ak, Bk, Ck, Dk, e, given, closed, noise, w, aux, t0, dt, substeps):  # type: ignore[no-untyped-def]
    """Return readings y (n, p), commands u (n, m) and plant states x (n, nx) at the sampling instants.

    ``code`` to ``offset``: tables of the effects (`afdsvc.trial.effect.law_tables`), whose states follow the plant's; A, B, C the
    plant; Ak to Dk the controller with inputs ``[y - ref, alpha]``; ``e (n, p + m)``: -ref and alpha; ``closed`` False plays
    the commands ``given (n, m)`` instead. ``noise (n, p)`` is added to the outputs, ``w (n, nx)`` to the rates;
    ``aux (n + 1, a)``; ``t0`` absolute time of the first sample.
    """
    samples, outputs = noise.shape
    n, size, width = A.shape[0], A.shape[0] + offset[-1], 1.0 / substeps
    X, xk, spare, m = np.zeros(size), np.zeros(Ak.shape[0]), np.zeros(Ak.shape[0]), np.zeros((code.size, c.MEMORY))
    u, y, clean, entry = np.zeros(B.shape[1]), np.zeros(outputs), np.zeros(outputs), np.zeros(e.shape[1])
    room, air = np.zeros((5, size + aux.shape[1] + u.size)), np.zeros(aux.shape[1])
    out_y, out_u, out_x = np.zeros((samples, outputs)), np.zeros((samples, u.size)), np.zeros((samples, n))
    clock = np.array([t0, 0.0, dt * width])
    groups = code // 10
    laws = (bool((groups <= c.COMMAND_WITH_MEMORY).any()), bool(((groups >= c.AXIS) & (groups <= c.MACHINE)).any()))
    for k in range(samples):
        if k == 0:
            _around(aux, 0, 0.0, air)
            _sense(code, at, p, clean, air, m, clock)
        for i in range(outputs):
            y[i] = clean[i] + noise[k, i]
        _read(code, at, p, y)
        if closed:  # what is played instead has no entries: reading them would be reading beyond the array
            for i in range(entry.size):
                entry[i] = e[k, i] + (y[i] if i < outputs else 0.0)
            _control(Ak, Bk, Ck, Dk, xk, spare, entry, u)
        else:
            u[:] = given[k]
        out_y[k], out_u[k], out_x[k] = y, u, X[:n]
        for j in range(substeps):
            share = j * width
            _step(laws, code, at, p, offset, A, B, u, w, k, aux, X, room, m, clock, t0 + (k + share) * dt, (k + share) * dt, share, width)
            _outputs(C, X, clean)
            if code.size:
                _around(aux, k, share + width, air)
                _sense(code, at, p, clean, air, m, clock)
    return out_y, out_u, out_x


@dataclass(frozen=True, slots=True, eq=False)
class RunPlan:
    """A recording to be made: alpha (n, m), ref (n, p), aux (n + 1, a), sensor noise (n, p), coloured noise of unit rms
    (n, p), disturbance of the rates (n, nx), absolute time of the first sample, and samples to drop at the start."""

    name: str
    alpha: Array
    ref: Array
    aux: Array
    noise: Array
    colour: Array
    push: Array
    t0: float
    skip: int

    def quiet(self) -> RunPlan:
        """Return the run without any noise."""
        return replace(self, noise=0 * self.noise, colour=0 * self.colour, push=0 * self.push)


@dataclass(frozen=True, slots=True, eq=False)
class RunSignals:
    """What came back, from the first sample of the run: readings y (n, p), commands u (n, m), plant states x (n, nx)."""

    y: Array
    u: Array
    x: Array

    def kept(self, run: RunPlan) -> RunSignals:
        """Return the part that is recorded."""
        return RunSignals(self.y[run.skip :], self.u[run.skip :], self.x[run.skip :])


def play_run(machine: TrialMachine, truth: Truth, run: RunPlan) -> RunSignals:
    """Return the closed loop's signals; raises `Refused` when it leaves the machine's reach."""
    entry = np.hstack([-run.ref, run.alpha])
    return _integrate(machine, truth, run, entry, np.zeros((1, run.alpha.shape[1])), True)


def replay(machine: TrialMachine, truth: Truth, run: RunPlan, u: Array) -> RunSignals:
    """Return the plant's answer to given commands u (n, m), with the run's noise."""
    return _integrate(machine, truth, run, np.zeros((1, run.alpha.shape[1] + run.ref.shape[1])), u, False)


def _integrate(machine: TrialMachine, truth: Truth, run: RunPlan, entry: Array, u: Array, closed: bool) -> RunSignals:
    K = machine.loop
    control = tuple(np.ascontiguousarray(M) for M in (K.A, K.B, K.C, K.D))
    y, out_u, x = integrate(  # type: ignore[call-arg]  # a compiled function takes what it was compiled for
        *law_tables(truth.everything), *machine.matrices(truth.constants()), *control, entry, np.ascontiguousarray(u), closed,
        run.noise + _hidden_noise(truth, run), run.push, run.aux, run.t0, machine.dt, machine.substeps,
    )
    if closed and not np.abs(y).max() <= machine.reach:
        raise Refused(f"{machine.name}: {', '.join(e.physics for e in truth.everything)} drives it beyond {machine.reach:.3g}")
    return RunSignals(y, out_u, x)


def _hidden_noise(truth: Truth, run: RunPlan) -> Array:
    extra = np.zeros_like(run.noise)
    for effect in truth.everything:
        if effect.code == c.NOISE:
            extra[:, effect.at[0]] += effect.values[0] * run.colour[:, effect.at[0]]
    return extra
