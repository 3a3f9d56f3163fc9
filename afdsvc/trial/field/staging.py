"""The recordings of a field trial before anything is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array
from afdsvc.trial.conditions import wandering
from afdsvc.trial.effects.effect import Truth
from afdsvc.trial.field import plants
from afdsvc.trial.field.conditions import SHAPES, Conditions
from afdsvc.trial.field.kinds_motion import SUPPLY
from afdsvc.trial.field.rig import Rig
from afdsvc.trial.field.simulation import CONTROLLED, OPEN, RELAY, Run, Signals, play

Generator = np.random.Generator
PREROLL = 4.0  # times tau that pass before the recording of a running machine begins
QUIET_LOOP = 0.3  # noise of a machine under a controller, as a share of that of others: its derivative makes it commands
DRIVEN = {plants.TANKS: (0,), plants.STORES: (0,), plants.MODES: (1, 3), plants.FIRST: (0,), plants.IMPOSED: ()}


def stage(rig: Rig, given: Conditions, g: Generator) -> tuple[Run, ...]:
    """Return the runs, the holdout last."""
    runs = [_run(rig, given, k, chance) for k, chance in enumerate(g.spawn(given.files))]
    calm = play(rig, Truth(rig.nominal), runs[-1].quiet())
    return tuple(_noisy(rig, given, run, calm, chance) for run, chance in zip(runs, g.spawn(given.files), strict=True))


def true_constants(rig: Rig, given: Conditions, g: Generator) -> Array:
    """Return the machine's constants, drawn from the catalogue's error and cut at two standard deviations."""
    errors = np.clip(g.standard_normal(rig.nominal.size), -2.0, 2.0)
    return rig.nominal * (1.0 + given.wrong * rig.loose * errors)


def _run(rig: Rig, given: Conditions, k: int, g: Generator) -> Run:
    skip = round(PREROLL * rig.tau / rig.dt) if given.running and rig.inputs else 0
    n, p, m = given.samples[k] + skip, len(rig.outputs), len(rig.inputs)
    size = rig.level * given.levels[k]
    shapes = np.column_stack([_shape(rig, given, n, chance) for chance in g.spawn(max(m, 1))]) if m else np.zeros((n, 0))
    run = Run(
        name="holdout" if k == given.files - 1 else f"recording_{k + 1}", alpha=size * shapes, ref=np.zeros((n, p)),
        start=np.zeros(rig.order), noise=np.zeros((n, p)), push=np.zeros((n, rig.order)),
        aux=SUPPLY * (1.0 + 0.05 * wandering(np.arange(n, dtype=np.float64) * rig.dt, g)), t0=float(g.uniform(0, 1000)) * rig.tau, skip=skip, mode=OPEN,
    )
    if rig.controller is not None:
        return replace(run, alpha=0 * run.alpha, ref=run.alpha, mode=CONTROLLED)
    if rig.swing is not None:
        return replace(run, start=rig.swing * g.uniform(0.6, 1.0) * g.choice([-1.0, 1.0]))
    return replace(run, mode=RELAY, width=0.1 * _still(rig, size)) if given.excitation == "relay" else run


def _shape(rig: Rig, given: Conditions, n: int, g: Generator) -> Array:
    """Return one excitation of unit size; an imposed motion is the rate of one."""
    shape = SHAPES[given.excitation](n, rig.dt, rig.tau, g)
    if rig.plant != plants.IMPOSED:
        return shape
    rate = np.diff(shape, append=shape[-1])
    return np.asarray(rate / np.abs(rate).max())


def _still(rig: Rig, size: float) -> float:
    """Return what the nominal machine's first output settles at under a constant command."""
    A, B, C, _ = rig.build(rig.nominal)
    return float(abs((C @ np.linalg.solve(A, B))[0, 0]) * size)


def _noisy(rig: Rig, given: Conditions, run: Run, calm: Signals, g: Generator) -> Run:
    """Return the run with noise sized by the nominal answer ``calm``."""
    rms = np.sqrt(np.square(calm.y).mean(axis=0)) * (QUIET_LOOP if rig.controller is not None else 1.0)
    n, p = run.noise.shape
    t = np.arange(n, dtype=np.float64) * rig.dt
    slow = np.column_stack([wandering(t, g) for _ in range(p)])
    noise = rms * (given.white * g.standard_normal((n, p)) + given.coloured * _colour(g.standard_normal((n, p)), given.colour))
    push, driven = np.zeros_like(run.push), DRIVEN.get(rig.plant, tuple(a.speed for a in rig.axes))
    for k in driven:
        size = given.push * np.sqrt(np.square(calm.x[:, k]).mean()) / rig.fast
        push[:, k] = size * _colour(g.standard_normal((n, 1)), float(np.exp(-rig.dt / (0.3 * rig.tau))))[:, 0]
    return replace(run, noise=noise + rms * given.drift * slow, push=push)


def _colour(white: Array, pole: float) -> Array:
    return np.asarray(lfilter([np.sqrt(1 - pole * pole)], [1.0, -pole], white, axis=0))
