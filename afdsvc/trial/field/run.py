"""One recording of a field trial before and after it is made, and how the truth or a model is simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Effect, Truth
from afdsvc.trial.field.kernel import OPEN, simulate
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.laws import field_codes as f

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
    """Return one row per law (see `afdsvc.trial.laws.field_codes`) and the number of all states."""
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
