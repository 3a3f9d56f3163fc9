"""The recordings of a trial before anything is hidden: what is played, at which level and speed, in which noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.lti.statespace import Array
from afdsvc.trial.conditions.ambient import ambient, coloured, sensor_noise
from afdsvc.trial.conditions.excitation import multisines, operation, sines
from afdsvc.trial.effects.effect import Truth
from afdsvc.trial.effects.site import rms
from afdsvc.trial.machines.machine import Machine
from afdsvc.trial.options import Options
from afdsvc.trial.simulation.run import Run, play

NAMES = ("recording_1", "recording_2", "recording_3", "holdout")
TRAIN = 2  # the first so many recordings define rho
PROCESS_SHARE = 0.4  # rms in the outputs of the noise that drives the states, over that of the sensors' noise


def stage(machine: Machine, options: Options, generator: np.random.Generator) -> tuple[Run, ...]:
    """Return four runs: two to fit (two levels, two speeds), one to select, one to hold out."""
    levels = machine.recording.levels
    if options.excitation == "one_level":
        levels = (levels[0],) * 4
    return tuple(
        _run(machine, options, name, level, speed, chance)
        for name, level, speed, chance in zip(NAMES, levels, machine.recording.speeds, generator.spawn(4), strict=True)
    )


def true_constants(machine: Machine, options: Options, generator: np.random.Generator) -> Array:
    """Return the plant's constants, drawn from the stated uncertainty and cut at two standard deviations."""
    errors = generator.standard_normal(machine.nominal.size)
    while np.abs(errors).max() > 2:
        errors = np.where(np.abs(errors) > 2, generator.standard_normal(errors.size), errors)
    return machine.nominal * (1.0 + options.parameter_error * machine.theta_sd * errors)


def _run(
    machine: Machine, options: Options, name: str, level: float, speed: float, generator: np.random.Generator
) -> Run:
    r = machine.recording
    skip, kept = round(r.preroll / machine.dt), round(r.period * (options.periods or r.periods) / machine.dt)
    play_chance, air, noise, colour, push, start = generator.spawn(6)
    t = np.arange(skip + kept + 1, dtype=np.float64) * machine.dt
    alpha, ref = _played(machine, options, t[skip:-1] - t[skip], skip, play_chance)
    n = skip + kept
    pole = float(colour.uniform(0.8, 0.97))
    run = Run(
        name=name,
        alpha=alpha,
        ref=ref,
        aux=ambient(machine, speed, t, air),
        noise=sensor_noise(machine, options.noise, n, noise),
        colour=coloured(colour.standard_normal((n, machine.sigma.size)), pole),
        push=np.zeros((n, len(machine.states))),
        t0=float(start.uniform(0, 1000)),
        skip=skip,
    )
    run = _levelled(machine, run, level)
    return _pushed(machine, run, push) if options.noise == "process" else run


def _played(
    machine: Machine, options: Options, t: Array, skip: int, generator: np.random.Generator
) -> tuple[Array, Array]:
    shapes = {"sine": sines, "operation": operation}.get(options.excitation, multisines)
    alpha, ref = shapes(machine, t, generator)
    quiet = ((skip, 0), (0, 0))
    return np.pad(alpha, quiet), np.pad(ref, quiet)


def _levelled(machine: Machine, run: Run, level: float) -> Run:
    """Return the run with alpha and ref scaled so that the nominal outputs reach the level (rms of the largest).

    Alpha and ref give half the level each where both are played.
    """
    share = level / 2 if run.alpha.any() and run.ref.any() else level
    alpha, ref = run.alpha, run.ref
    if alpha.any():
        alpha = alpha * share / _answer(machine, replace(run, ref=0 * ref))
    if ref.any():
        ref = ref * share / _answer(machine, replace(run, alpha=0 * run.alpha))
    return replace(run, alpha=alpha, ref=ref)


def _answer(machine: Machine, run: Run) -> float:
    """Return the nominal rms of the largest output, without noise and without a limit: shapes are of any size yet."""
    boundless = replace(machine, reach=np.inf)
    return float(rms(play(boundless, Truth(machine.nominal), run.quiet()).kept(run).y).max())


def _pushed(machine: Machine, run: Run, generator: np.random.Generator) -> Run:
    """Return the run with white accelerations that give `PROCESS_SHARE` of the sensors' noise in the outputs."""
    push = np.zeros_like(run.push)
    for axis in machine.axes:
        push[:, axis.velocity] = generator.standard_normal(push.shape[0])
        alone = np.where(np.arange(push.shape[1]) == axis.velocity, push, 0.0)
        calm = replace(run.quiet(), alpha=0 * run.alpha, ref=0 * run.ref, push=alone)
        seen = rms(play(replace(machine, reach=np.inf), Truth(machine.nominal), calm).kept(run).y)[axis.output]
        push[:, axis.velocity] *= PROCESS_SHARE * machine.sigma[axis.output] / seen
    return replace(run, push=push)
