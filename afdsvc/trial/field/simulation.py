"""One recording of a field trial before and after it is made, and how the truth or a model is simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effect import Effect, Truth
from afdsvc.trial.field.rig import IMPOSED, Rig, outputs, rates
from afdsvc.trial.laws import field as f
from afdsvc.trial.laws.field import MEMORY, held, readout, sensed

OPEN, CONTROLLED, RELAY = range(3)


@numba.njit(cache=True, error_model="numpy")
def _slopes(plant, c, v, w, t, since, X, dX, law, y):  # type: ignore[no-untyped-def]
    """Fill dX with all rates and y with what the sensors show."""
    dX[:] = 0.0
    rates(plant, c, v, w, t, X, dX, law)
    outputs(plant, c, v, t, X, dX, law, y)
    for i in range(y.size):
        y[i] = sensed(law, i, y[i], y[(i + 1) % y.size], since, X, dX)


@numba.njit(cache=True, error_model="numpy")
def _step(plant, c, v, w, t0, since, h, X, dX, law, y, place, mean):  # type: ignore[no-untyped-def]
    """Advance X over h seconds by the classical Runge-Kutta scheme."""
    mean[:] = 0.0
    ahead = 0.0
    for stage in range(4):
        for i in range(X.size):
            place[i] = X[i] + ahead * h * dX[i]
        _slopes(plant, c, v, w, t0 + since + ahead * h, since + ahead * h, place, dX, law, y)
        for i in range(X.size):
            mean[i] += dX[i] / (6.0 if stage == 0 or stage == 3 else 3.0)
        ahead = 0.5 if stage < 2 else 1.0
    for i in range(X.size):
        X[i] += h * mean[i]


@numba.njit(cache=True, error_model="numpy")
def _controlled(K, xk, y, ref, alpha, u):  # type: ignore[no-untyped-def]
    """Fill u with K (y - ref) + alpha and step the controller; K stacks ``[A B; C D]``."""
    n = xk.size
    e = np.concatenate((xk, y - ref))
    both = K @ e
    u[:] = both[n:] + alpha
    xk[:] = both[:n]


@numba.njit(cache=True, error_model="numpy")
def simulate(plant, c, law, x0, mode, K, order, alpha, ref, noise, push, aux, t0, dt, substeps):  # type: ignore[no-untyped-def]
    """Return readings y (n, p), commands u (n, m) and states x (n, all) at the sampling instants.

    ``mode`` OPEN: the command is ``alpha (n, m)``; CONTROLLED: ``K (y - ref) + alpha``; RELAY: ``|alpha|`` with the sign opposite
    to the first reading less ``ref``, changed when it passes ``K[0, 0]``. ``noise (n, p)`` is added to the readings before their resolution,
    ``push (n, states of the plant)`` to the rates; ``aux (n,)`` is an auxiliary signal.
    """
    n, m, h = alpha.shape[0], alpha.shape[1], dt / substeps
    X, dX, place, mean = x0.copy(), np.zeros(x0.size), np.zeros(x0.size), np.zeros(x0.size)
    memory, xk, sign = np.zeros((law.shape[0], MEMORY)), np.zeros(order), 1.0
    y, u, v = np.zeros(noise.shape[1]), np.zeros(m), np.zeros(m)
    out_y, out_u, out_x = np.zeros(noise.shape), np.zeros((n, m)), np.zeros((n, x0.size))
    for k in range(n):
        if plant == IMPOSED:  # the force answers the speed of this very sample
            v[:] = alpha[k]
        _slopes(plant, c, v, push[k], t0 + k * dt, k * dt, X, dX, law, y)
        for i in range(y.size):
            y[i] = readout(law, i, y[i] + noise[k, i])
        u[:] = alpha[k]
        if mode == CONTROLLED:
            _controlled(K, xk, y, ref[k], alpha[k], u)
        elif mode == RELAY:
            if abs(y[0] - ref[k, 0]) > K[0, 0]:
                sign = -1.0 if y[0] > ref[k, 0] else 1.0
            u *= sign
        out_y[k], out_u[k], out_x[k] = y, u, X
        for j in range(substeps):
            for i in range(m):
                v[i] = held(law, memory, i, u[i], aux[k], h)
            _step(plant, c, v, push[k], t0, (k + j / substeps) * dt, h, X, dX, law, y, place, mean)
    return out_y, out_u, out_x


FINER = 4  # integration steps in place of one where a law has a steep flank


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A recording to be made: excitation ``alpha (n, m)`` and ``ref (n, p)``, start of the plant's states, noise of the sensors
    (n, p), noise of the rates ``push (n, states)``, auxiliary signal (n,), time of the first sample, samples that are not kept, mode of
    the loop and width of a relay."""

    name: str
    alpha: Array
    ref: Array
    start: Array
    noise: Array
    push: Array
    aux: Array
    t0: float
    skip: int
    mode: int
    width: float = 0.0

    def quiet(self) -> Run:
        """Return the run without any noise."""
        return replace(self, noise=0 * self.noise, push=0 * self.push)

    def commanded(self, u: Array) -> Run:
        """Return the run in which these commands are played, without noise and without a loop."""
        return replace(self.quiet(), alpha=u, mode=OPEN)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What came back from the first sample of the run: readings y (n, p), commands u (n, m), states of the plant x (n, order)."""

    y: Array
    u: Array
    x: Array


def law_table(effects: tuple[Effect, ...], order: int) -> tuple[Array, int]:
    """Return one row per law (see `afdsvc.trial.laws.field`) and the number of all states."""
    laws = [e for e in effects if e.code >= 0]
    table, total = np.zeros((len(laws), f.COLUMNS)), order
    for row, e in zip(table, laws, strict=True):
        row[: f.VALUES] = e.code, e.at[0], total
        row[f.VALUES : f.VALUES + len(e.base)] = e.values
        total += e.states
    return table, total


def play(rig: Rig, truth: Truth, run: Run) -> Signals:
    """Return what the machine answers; raises `Refused` when it runs away."""
    law, total = law_table(truth.everything, rig.order)
    substeps = rig.substeps * (FINER if np.isin(law[:, f.CODE], f.SHARP).any() else 1)
    if law[law[:, f.CODE] == f.LATE, f.VALUES].sum() * substeps > (f.MEMORY - 2) * rig.dt:
        raise Refused(f"{rig.family}: a delay longer than what is remembered")
    K, order = (np.full((1, 1), run.width), 0) if rig.controller is None else (rig.stacked, rig.controller.order)
    y, u, x = simulate(
        rig.plant, truth.constants(), law, np.concatenate([run.start, np.zeros(total - rig.order)]), run.mode, K, order,
        run.alpha, run.ref, run.noise, run.push, run.aux, run.t0, rig.dt, substeps,
    )
    if not np.isfinite(y).all() or not np.isfinite(u).all():
        raise Refused(f"{rig.family}: {', '.join(e.site for e in truth.everything)} makes it run away")
    return Signals(y, u, x[:, : rig.order])


def modelled(rig: Rig, truth: Truth, run: Run, played: Signals) -> Array:
    """Return the outputs that a model (the structure and constants of ``truth``) simulates for a recording, from its true start.

    In closed loop where the model's owner knows the controller, from the recorded commands otherwise; without noise.
    """
    again = run.quiet() if rig.loop else run.commanded(played.u)
    return play(rig, truth, again).y
