"""One recording before and after it is made: what is played, what happens around it, and what came back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Truth, tables
from afdsvc.trial.laws import codes as c
from afdsvc.trial.machines.machine import Machine
from afdsvc.trial.simulation.kernel import run as integrate


@dataclass(frozen=True, slots=True, eq=False)
class Run:
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

    def quiet(self) -> Run:
        """Return the run without any noise."""
        return replace(self, noise=0 * self.noise, colour=0 * self.colour, push=0 * self.push)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What came back, from the first sample of the run: readings y (n, p), commands u (n, m), plant states x (n, nx)."""

    y: Array
    u: Array
    x: Array

    def kept(self, run: Run) -> Signals:
        """Return the part that is recorded."""
        return Signals(self.y[run.skip :], self.u[run.skip :], self.x[run.skip :])


def play(machine: Machine, truth: Truth, run: Run) -> Signals:
    """Return the closed loop's signals; raises `Refused` when it leaves the machine's reach."""
    entry = np.hstack([-run.ref, run.alpha])
    return _integrate(machine, truth, run, entry, np.zeros((1, run.alpha.shape[1])), True)


def replay(machine: Machine, truth: Truth, run: Run, u: Array) -> Signals:
    """Return the plant's answer to given commands u (n, m), with the run's noise."""
    return _integrate(machine, truth, run, np.zeros((1, run.alpha.shape[1] + run.ref.shape[1])), u, False)


def _integrate(machine: Machine, truth: Truth, run: Run, entry: Array, u: Array, closed: bool) -> Signals:
    K = machine.loop
    control = tuple(np.ascontiguousarray(M) for M in (K.A, K.B, K.C, K.D))
    y, out_u, x = integrate(  # type: ignore[call-arg]  # a compiled function takes what it was compiled for
        *tables(truth.everything), *machine.matrices(truth.constants()), *control, entry, np.ascontiguousarray(u), closed,
        run.noise + _hidden_noise(truth, run), run.push, run.aux, run.t0, machine.dt, machine.substeps,
    )
    if closed and not np.abs(y).max() <= machine.reach:
        raise Refused(f"{machine.name}: {', '.join(e.physics for e in truth.everything)} drives it beyond {machine.reach:.3g}")
    return Signals(y, out_u, x)


def _hidden_noise(truth: Truth, run: Run) -> Array:
    extra = np.zeros_like(run.noise)
    for effect in truth.everything:
        if effect.code == c.NOISE:
            extra[:, effect.at[0]] += effect.values[0] * run.colour[:, effect.at[0]]
    return extra
