"""Could the data have told? How far apart two explanations are, when each is fitted as well as it can be.

A rival (another name, or the same name elsewhere) is fitted, in the generator's own form and together with the plant's
constants, to what the recordings would be without noise. What is left, in units of the noise, is d: no test whatever, given
these recordings, can tell the two apart with a probability of being right above Phi(d / 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.errors import AfdsvcError
from afdsvc.trial.conditions import TRAIN
from afdsvc.trial.effects.catalogue import CHANGE, changes_at, make_effect
from afdsvc.trial.effects.effect import Effect, Truth
from afdsvc.trial.effects.severity import scaled_to
from afdsvc.trial.effects.site import EffectSite, SignalSizes, signal_sizes
from afdsvc.trial.generate import BlindTrial
from afdsvc.trial.scoring.matching import same_change
from afdsvc.trial.scoring.oracle import Data, gauss_newton, prior, residuals, simulated
from afdsvc.trial.simulation import RunSignals

UNDECIDABLE = 4.65  # below this d the best possible test is wrong more often than once in a hundred
SHARED = ("frequency", "phase", "damping_ratio", "delay", "time_constant")  # shapes a rival takes over from what is hidden
STARTS, STEPS = 2, 6


def rival_distance(trial: BlindTrial, entry: Mapping[str, Any]) -> float:
    """Return d between the trial's one hidden effect and the entry of ``named``; infinite when it cannot be made up here."""
    physics, site = str(entry.get("physics", "")), str(entry.get("site", ""))
    if physics == CHANGE:
        physics = next((f"{CHANGE}:{p}" for s, p in trial.machine.changes if same_change(trial.machine, (p, s), entry)), "")
        site = next((s for name, s in changes_at(trial.machine) if name == physics), site)
    best = float("inf")
    for start in range(STARTS):
        best = min(best, _fitted(trial, physics, site, start))
        if best < UNDECIDABLE:
            break
    return best


def _fitted(trial: BlindTrial, physics: str, site: str, start: int) -> float:
    size = signal_sizes(trial.machine, trial.truth, trial.runs[:TRAIN])
    try:
        rival = _scaled(trial, _shape(trial, size, physics, site, start))
    except (AfdsvcError, ValueError):
        return float("inf")
    data: Data = [
        (run, RunSignals(simulated(trial, _question(trial), run, signals), signals.u, signals.x))
        for run, signals in zip(trial.runs[:-1], trial.played[:-1], strict=True)
    ]
    best = _descend(trial, Truth(trial.truth.theta, (rival,)), data)
    return float(np.sqrt(max(best - prior(trial, _question(trial)), 0.0)))


def _question(trial: BlindTrial) -> Truth:
    return Truth(trial.truth.theta, trial.truth.effects)


def _shape(trial: BlindTrial, size: SignalSizes, physics: str, site: str, start: int) -> Effect:
    """Return the rival with shapes drawn anew but for those it shares with what is hidden.

    It may move no more parameters than what is hidden has: a law that contains another is told from it by parsimony.
    """
    machine = trial.machine
    effect = make_effect(EffectSite(machine, size, site, machine.index(site), np.random.default_rng(start)), physics)
    known = dict(zip(trial.truth.effects[0].names, trial.truth.effects[0].values, strict=True))
    shared = (known.get(name, value) if name in SHARED else value for name, value in zip(effect.names, effect.base, strict=True))
    free = effect.free[: len(trial.truth.effects[0].free)]
    return replace(effect, base=tuple(float(v) for v in shared), free=free)


def _scaled(trial: BlindTrial, effect: Effect) -> Effect:
    rho, measure = trial.answer.hidden[0].rho, trial.options.measured(trial.machine)
    return scaled_to(trial.machine, Truth(trial.truth.theta), effect, trial.runs[:TRAIN], rho, measure)


def _cost(trial: BlindTrial, truth: Truth, data: Data) -> float:
    return float(np.square(residuals(trial, truth, data)).sum()) + prior(trial, truth)


def _descend(trial: BlindTrial, truth: Truth, data: Data) -> float:
    """Return the least cost found by Gauss-Newton steps, halved while they do not help."""
    cost, damping = _cost(trial, truth, data), 1.0
    for _ in range(STEPS):
        step = gauss_newton(trial, truth, data, damping)
        new = _cost(trial, step, data)
        if not new < cost:
            damping /= 4
            continue
        done = cost - new < max(0.1, 0.03 * new) or new < 1.0
        truth, cost, damping = step, new, min(1.0, 2 * damping)
        if done:
            break
    return cost
