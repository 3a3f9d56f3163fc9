"""What a machine of a field trial is recorded under, and its recordings before anything is hidden."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array
from afdsvc.trial.conditions import wandering
from afdsvc.trial.effect import Truth
from afdsvc.trial.field import rig as plants
from afdsvc.trial.field.kinds import SUPPLY
from afdsvc.trial.field.rig import IMPOSED, Rig, spread
from afdsvc.trial.field.simulation import CONTROLLED, OPEN, RELAY, Run, Signals, play

Generator = np.random.Generator
REPEATING = ("multisine", "periods")
ONCE = ("staircase", "aprbs", "steps", "chirp", "operation", "random", "relay")


def staircase(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return levels up and down again in even steps of 1.5 to 4 times tau, one way only half of the time."""
    hold, count = max(2, round(g.uniform(1.5, 4.0) * tau / dt)), int(g.integers(4, 9))
    up = np.linspace(0.0 if g.random() < 0.5 else -1.0, 1.0, count)
    levels = np.concatenate([up, up[-2:0:-1]])
    return np.asarray(levels[(np.arange(n) // hold) % levels.size])


def aprbs(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return random levels held for random times of 0.3 to 4 times tau."""
    return _held(n, dt, tau, g, 0.3, 4.0)


def steps(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a few large steps to random levels of either sign, 4 to 8 times tau apart."""
    levels = _held(n, dt, tau, g, 4.0, 8.0)
    return np.where(levels < 0, -0.4, 0.4) + 0.6 * levels


def _held(n: int, dt: float, tau: float, g: Generator, low: float, high: float) -> Array:
    out, k = np.zeros(n), 0
    while k < n:
        length = max(2, round(g.uniform(low, high) * tau / dt))
        out[k : k + length] = g.uniform(-1.0, 1.0)
        k += length
    return out


def chirp(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a sine whose frequency grows from 0.03 / tau to about 1.5 / tau by a constant factor per second."""
    t, low, high = np.arange(n) * dt, 0.03 / tau, g.uniform(0.8, 2.0) / tau
    rate = np.log(high / low) / (n * dt)
    return np.asarray(np.sin(2 * np.pi * low * np.expm1(rate * t) / rate + g.uniform(0, 2 * np.pi)))


def operation(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return smooth moves to random places with rests between, as a production program makes them."""
    out, k, place = np.zeros(n), 0, 0.0
    while k < n:
        move, rest = (max(2, round(g.uniform(a, b) * tau / dt)) for a, b in ((0.8, 3.0), (0.2, 3.0)))
        target, s = float(g.uniform(-1.0, 1.0)), np.minimum(np.arange(1, move + rest + 1) / move, 1.0)
        part = place + (target - place) * s**3 * (10 - 15 * s + 6 * s * s)
        out[k : k + part.size] = part[: n - k]
        place, k = target, k + part.size
    return out


def random(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return filtered noise with a correlation time of 0.1 to 0.6 times tau, held to +-1."""
    pole = np.exp(-dt / (g.uniform(0.1, 0.6) * tau))
    x = lfilter([np.sqrt(1 - pole * pole)], [1.0, -pole], g.standard_normal(n))
    return np.clip(0.45 * np.asarray(x), -1.0, 1.0)


def relay(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return the size of a relay's output, which the machine itself switches, changed now and then."""
    return 0.6 + 0.4 * np.abs(_held(n, dt, tau, g, 10.0, 30.0))


def multisine(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a multisine of random phases below 1.2 / tau that repeats three to six times."""
    period = n // int(g.integers(3, 7))
    lines = np.arange(1, max(4, int(1.2 / tau * period * dt)))
    lines = g.choice(lines, min(lines.size, 40), replace=False)
    phases = g.uniform(0, 2 * np.pi, lines.size)
    x = np.cos(2 * np.pi / period * np.outer(np.arange(period), lines) + phases).sum(axis=1)
    return np.asarray(np.resize(x / np.abs(x).max(), n))


def periods(n: int, dt: float, tau: float, g: Generator) -> Array:
    """Return a random level sequence that repeats three to six times."""
    period = n // int(g.integers(3, 7))
    return np.resize(aprbs(period, dt, tau, g), n)


SHAPES = {shape.__name__: shape for shape in (staircase, aprbs, steps, chirp, operation, random, relay, multisine, periods)}


LARGEST, SMALLEST = 20_000, 500  # samples of a file
LONG_ENOUGH = 15  # times tau that a file lasts at least
COLOURED, DRIFTING = 0.5, 0.4  # shares of the trials


@dataclass(frozen=True, slots=True)
class Conditions:
    """Circumstances of a trial; sizes are relative to the rms of the outputs (``push``: of what drives the axis).

    ``files`` recordings of ``samples`` each are given, the last one is the holdout. ``white`` and ``coloured`` are noise of
    the sensors, ``colour`` the pole per sample of the latter, ``push`` noise that drives the states. ``drift`` is the rms of a
    slow wander of the reading. ``resolution`` is one step of the reading (0: none). ``wrong`` is the standard deviation of the
    constants' errors, ``stated`` the one in the MODEL.toml (0: not stated there). ``running`` says that the machine was moving
    when the recording began, ``offset`` the reading and command at the operating point.
    """

    excitation: str
    repeating: bool
    files: int
    samples: tuple[int, ...]
    levels: tuple[float, ...]
    white: float
    coloured: float
    colour: float
    push: float
    drift: float
    resolution: float
    wrong: float
    stated: float
    running: bool
    offset: float
    aux: bool

    def as_json(self) -> dict[str, Any]:
        """Return the conditions as plain values."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def conditions(rig: Rig, nothing: bool, repeating: bool, g: np.random.Generator) -> Conditions:
    """Return drawn conditions; with ``nothing`` hidden noise is coloured, the stated uncertainty honest and drift below noise."""
    files = int(g.integers(2, 6))
    shortest = max(SMALLEST, round(LONG_ENOUGH * rig.tau / rig.dt))
    samples = tuple(int(np.clip(spread(g, shortest, 4 * shortest), SMALLEST, LARGEST)) for _ in range(files))
    white, wrong = spread(g, 0.002, 0.05), float(g.choice([0.05, 0.1, 0.2]))
    coloured = spread(g, 0.01, 0.08) if nothing or g.random() < COLOURED else 0.0
    honest = nothing or g.random() < 0.6
    stated = wrong if honest else wrong / 4
    drift = spread(g, 0.3, 1.0) * (white if nothing else 0.03) if g.random() < DRIFTING else 0.0
    return Conditions(
        excitation="free_decay" if not rig.inputs else _excitation(rig, repeating, g), repeating=repeating and bool(rig.inputs),
        files=files, samples=samples, levels=tuple(float(g.uniform(0.5, 1.0)) for _ in range(files)), white=white,
        coloured=coloured, colour=float(g.uniform(0.85, 0.995)), push=spread(g, 0.003, 0.03) if g.random() < 0.5 else 0.0,
        drift=drift, resolution=spread(g, 0.3, 3.0) * white if g.random() < 0.4 else 0.0, wrong=wrong,
        stated=0.0 if not nothing and abs(stated - 0.05) < 0.03 and g.random() < 0.5 else stated, running=bool(g.random() < 0.5),
        offset=spread(g, 1.0, 5.0) if rig.offsets and g.random() < 0.5 else 0.0, aux=bool(g.random() < 0.25),
    )


def _excitation(rig: Rig, repeating: bool, g: np.random.Generator) -> str:
    if rig.plant == IMPOSED:  # what an exciter can move by
        return "multisine" if repeating else str(g.choice(["chirp", "operation"]))
    kinds = [k for k in (REPEATING if repeating else ONCE) if k != "relay" or relay_fits(rig)]
    return str(g.choice(kinds))


def relay_fits(rig: Rig) -> bool:
    """Return whether a relay makes the machine oscillate: one input, no controller, a rising static gain."""
    return rig.family in ("servo", "arm", "tanks", "stores")


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
