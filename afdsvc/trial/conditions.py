"""The recordings of a trial before anything is hidden: what is played, at which level and speed, in which noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array
from afdsvc.trial.effect import Truth
from afdsvc.trial.machine import TrialMachine
from afdsvc.trial.machines import Options
from afdsvc.trial.simulation import RunPlan, play_run
from afdsvc.trial.site import column_rms

Lines = NDArray[np.int64]
REFERENCE_BAND = 5.0  # Hz; a reference excites below this


def odd_lines(period: float, band: tuple[float, float], channels: int, generator: np.random.Generator) -> list[Lines]:
    """Return, per channel, the odd harmonics of 1/period it gets: dealt out in turn, one of every four left out at random."""
    harmonics = np.arange(1, int(band[1] * period) + 1, 2, dtype=np.int64)
    harmonics = harmonics[harmonics >= band[0] * period]
    return [_without_detection(harmonics[i::channels], generator) for i in range(channels)]


def _without_detection(lines: Lines, generator: np.random.Generator) -> Lines:
    keep = np.ones(lines.size, dtype=bool)
    for start in range(0, lines.size, 4):
        keep[start + int(generator.integers(4)) :][:1] = False
    return lines[keep]


def _multisine(lines: Lines, period: float, t: Array, generator: np.random.Generator) -> Array:
    """Return the sum of unit sines at these harmonics with random phases, shape of t."""
    phases = generator.uniform(0, 2 * np.pi, lines.size)
    return np.asarray(np.sin(2 * np.pi / period * np.outer(t, lines) + phases).sum(axis=1))


def multisines(machine: TrialMachine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return alpha (n, m) and ref (n, p) as interleaved odd multisines."""
    r, m, p = machine.recording, len(machine.inputs), len(machine.outputs)
    channels = m + (p if r.reference else 0)
    lines = odd_lines(r.period, r.band, channels, generator)
    alpha = np.column_stack([_multisine(lines[i], r.period, t, generator) for i in range(m)])
    if not r.reference:
        return alpha, np.zeros((t.size, p))
    slow = [x[x <= REFERENCE_BAND * r.period] for x in lines[m:]]
    return alpha, np.column_stack([_multisine(x, r.period, t, generator) for x in slow])


def sines(machine: TrialMachine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return one sine per input, each at a frequency of its own that repeats with the period, and no reference."""
    r = machine.recording
    top = 0.35 * r.band[1] * r.period
    lines = generator.choice(np.arange(int(0.03 * r.band[1] * r.period) + 1, int(top)), len(machine.inputs), replace=False)
    alpha = [_multisine(np.array([k]), r.period, t, generator) for k in lines]
    return np.column_stack(alpha), np.zeros((t.size, len(machine.outputs)))


def _operation(machine: TrialMachine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return ordinary operation: moves from place to place for a machine that follows references, nothing otherwise."""
    alpha = np.zeros((t.size, len(machine.inputs)))
    ref = np.zeros((t.size, len(machine.outputs)))
    if machine.recording.reference:
        for column in ref.T:
            column[:] = _moves(t, generator)
    return alpha, ref


def _moves(t: Array, generator: np.random.Generator) -> Array:
    """Return smooth steps (cosine, 0.3 s long) to random places, one or two a second."""
    place, out, clock = 0.0, np.zeros(t.size), 0.0
    while clock < t[-1]:
        target = float(generator.uniform(-1, 1))
        move = np.clip((t - clock) / 0.3, 0, 1)
        out[t >= clock] = (place + (target - place) * (0.5 - 0.5 * np.cos(np.pi * move)))[t >= clock]
        place, clock = target, clock + float(generator.uniform(0.5, 1.0))
    return out


UNITS = {"speed": "rad/s", "angle": "rad", "pressure": "bar", "temperature": "degC", "supply": "V"}


def wandering(t: Array, generator: np.random.Generator) -> Array:
    """Return a slow signal of unit rms: five sines of 0.6 to 5 periods over the record, random phases."""
    span = t[-1] - t[0]
    turns = np.geomspace(0.6, 5.0, 5) * generator.uniform(0.85, 1.15, 5)
    phases = generator.uniform(0, 2 * np.pi, 5)
    x = np.sin(2 * np.pi * np.outer((t - t[0]) / span, turns) + phases).sum(axis=1)
    return np.asarray((x - x.mean()) / x.std())


def ambient(machine: TrialMachine, speed: float, t: Array, generator: np.random.Generator) -> Array:
    """Return the auxiliary signals, shape ``(t.size, aux)``; the angle is not wrapped."""
    turning = speed * (1.0 + 0.003 * wandering(t, generator))
    step = np.diff(t, prepend=t[0])
    signals = {
        "speed": turning,
        "angle": generator.uniform(0, 2 * np.pi) + np.cumsum(turning * step),
        "pressure": 6.0 * (1.0 + 0.05 * wandering(t, generator)),
        "temperature": 31.0 + 2.0 * (t - t[0]) / (t[-1] - t[0]) + 0.8 * wandering(t, generator),
        "supply": 48.0 * (1.0 + 0.04 * wandering(t, generator)),
    }
    return np.column_stack([signals[name] for name in machine.aux])


def sensor_noise(machine: TrialMachine, kind: str, samples: int, generator: np.random.Generator) -> Array:
    """Return the sensors' noise, shape ``(samples, p)``; ``kind`` white, coloured (equal variance), quieter or louder."""
    factor = {"quieter": 0.5, "louder": 2.0}.get(kind, 1.0)
    white = generator.standard_normal((samples, machine.sigma.size))
    unit = coloured(white, 0.8) if kind == "coloured" else white
    return factor * machine.sigma * unit


def coloured(white: Array, pole: float) -> Array:
    """Return noise of unit variance through a first-order low-pass with this pole."""
    return np.asarray(lfilter([np.sqrt(1 - pole * pole)], [1.0, -pole], white, axis=0))


NAMES = ("recording_1", "recording_2", "recording_3", "holdout")
TRAIN = 2  # the first so many recordings define rho
PROCESS_SHARE = 0.4  # rms in the outputs of the noise that drives the states, over that of the sensors' noise


def staged_runs(machine: TrialMachine, options: Options, generator: np.random.Generator) -> tuple[RunPlan, ...]:
    """Return four runs: two to fit (two levels, two speeds), one to select, one to hold out."""
    levels = machine.recording.levels
    if options.excitation == "one_level":
        levels = (levels[0],) * 4
    return tuple(
        _run(machine, options, name, level, speed, chance)
        for name, level, speed, chance in zip(NAMES, levels, machine.recording.speeds, generator.spawn(4), strict=True)
    )


def drawn_constants(machine: TrialMachine, options: Options, generator: np.random.Generator) -> Array:
    """Return the plant's constants, drawn from the stated uncertainty and cut at two standard deviations."""
    errors = generator.standard_normal(machine.nominal.size)
    while np.abs(errors).max() > 2:
        errors = np.where(np.abs(errors) > 2, generator.standard_normal(errors.size), errors)
    return machine.nominal * (1.0 + options.parameter_error * machine.theta_sd * errors)


def _run(
    machine: TrialMachine, options: Options, name: str, level: float, speed: float, generator: np.random.Generator
) -> RunPlan:
    r = machine.recording
    skip, kept = round(r.preroll / machine.dt), round(r.period * (options.periods or r.periods) / machine.dt)
    play_chance, air, noise, colour, push, start = generator.spawn(6)
    t = np.arange(skip + kept + 1, dtype=np.float64) * machine.dt
    alpha, ref = _played(machine, options, t[skip:-1] - t[skip], skip, play_chance)
    n = skip + kept
    pole = float(colour.uniform(0.8, 0.97))
    run = RunPlan(
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
    machine: TrialMachine, options: Options, t: Array, skip: int, generator: np.random.Generator
) -> tuple[Array, Array]:
    shapes = {"sine": sines, "operation": _operation}.get(options.excitation, multisines)
    alpha, ref = shapes(machine, t, generator)
    quiet = ((skip, 0), (0, 0))
    return np.pad(alpha, quiet), np.pad(ref, quiet)


def _levelled(machine: TrialMachine, run: RunPlan, level: float) -> RunPlan:
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


def _answer(machine: TrialMachine, run: RunPlan) -> float:
    """Return the nominal rms of the largest output, without noise and without a limit: shapes are of any size yet."""
    boundless = replace(machine, reach=np.inf)
    return float(column_rms(play_run(boundless, Truth(machine.nominal), run.quiet()).kept(run).y).max())


def _pushed(machine: TrialMachine, run: RunPlan, generator: np.random.Generator) -> RunPlan:
    """Return the run with white accelerations that give `PROCESS_SHARE` of the sensors' noise in the outputs."""
    push = np.zeros_like(run.push)
    for axis in machine.axes:
        push[:, axis.velocity] = generator.standard_normal(push.shape[0])
        alone = np.where(np.arange(push.shape[1]) == axis.velocity, push, 0.0)
        calm = replace(run.quiet(), alpha=0 * run.alpha, ref=0 * run.ref, push=alone)
        seen = column_rms(play_run(replace(machine, reach=np.inf), Truth(machine.nominal), calm).kept(run).y)[axis.output]
        push[:, axis.velocity] *= PROCESS_SHARE * machine.sigma[axis.output] / seen
    return replace(run, push=push)
