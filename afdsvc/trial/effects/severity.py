"""How large an effect must be to be seen: rho, its rms in the outputs over the rms of the noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from afdsvc.errors import Refused
from afdsvc.lti.statespace import Array
from afdsvc.trial.effects.effect import Effect, Truth
from afdsvc.trial.machines.machine import TrialMachine
from afdsvc.trial.simulation import RunPlan, play_run, replay

TOLERANCE = 0.01  # relative, of rho
SPAN = (-16.0, 14.0)  # log severities tried


def effect_visibility(machine: TrialMachine, truth: Truth, runs: tuple[RunPlan, ...], measure: str) -> tuple[float, Array]:
    """Return rho of everything in ``truth.effects`` together and the effect's rms per output over that output's noise.

    rho = sqrt(sum of squared differences with and without / sum of squared sigma), over the recorded samples of the runs, with
    the very same noise. ``measure`` says what "without" means: ``commands``, the plant without the effects under the
    commands that the loop with them sent (what is left in ``y - G u``, where the evidence is); ``loop``, the closed loop
    without them, so that what feedback makes of the effect counts too.
    """
    apart = np.vstack([difference(machine, truth, run, measure) for run in runs])
    power = np.mean(np.square(apart), axis=0)
    return float(np.sqrt(power.sum() / np.square(machine.sigma).sum())), np.sqrt(power) / machine.sigma


def difference(machine: TrialMachine, truth: Truth, run: RunPlan, measure: str) -> Array:
    """Return what ``truth.effects`` add to the recorded outputs of a run, shape (n, p); see `effect_visibility`."""
    bare = truth.with_effects()
    signals = play_run(machine, truth, run)
    other = play_run(machine, bare, run) if measure == "loop" else replay(machine, bare, run, signals.u)
    return signals.kept(run).y - other.kept(run).y


def scaled_to(
    machine: TrialMachine, truth: Truth, effect: Effect, runs: tuple[RunPlan, ...], rho: float, measure: str
) -> Effect:
    """Return the effect at the severity that gives this rho > 0 on the runs; raises `Refused` when none does."""

    def gap(log_severity: float) -> float:
        candidate = truth.with_effects(effect.scaled(float(np.exp(log_severity))))
        try:
            seen, _ = effect_visibility(machine, candidate, runs, measure)
        except Refused:
            return float("inf")
        return float(np.log(max(seen, 1e-12) / rho))

    found = _root(gap)
    if found is None:
        raise Refused(f"no severity of '{effect.physics}' at '{effect.site}' gives rho {rho}; a smaller one is wanted")
    return effect.scaled(float(np.exp(found)))


def _root(gap: Callable[[float], float]) -> float | None:
    """Return where a rising function of log severity is zero within the tolerance, starting from 0; None when nowhere."""
    low, high, x = -np.inf, np.inf, 0.0
    below, above = -np.inf, np.inf
    for _ in range(40):
        value = gap(x)
        if abs(value) < TOLERANCE:
            return x
        if value < 0:
            low, below = x, value
        else:
            high, above = x, value
        if not (SPAN[0] < x < SPAN[1]) or high - low < 1e-9:
            return None
        x = _next(x, value, low, high, below, above)
    return None


def _next(x: float, value: float, low: float, high: float, below: float, above: float) -> float:
    """Return the next log severity to try: proportional steps until the root is bracketed, then inside the bracket."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return x - float(np.clip(value, -2.0, 2.0))
    share = -below / (above - below) if np.isfinite(above) else 0.5
    return low + float(np.clip(share, 0.1, 0.9)) * (high - low)
