"""What is played into a made-up machine: odd multisines with detection lines, one sine, or ordinary operation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afdsvc.lti.statespace import Array
from afdsvc.trial.machines.machine import Machine

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


def multisine(lines: Lines, period: float, t: Array, generator: np.random.Generator) -> Array:
    """Return the sum of unit sines at these harmonics with random phases, shape of t."""
    phases = generator.uniform(0, 2 * np.pi, lines.size)
    return np.asarray(np.sin(2 * np.pi / period * np.outer(t, lines) + phases).sum(axis=1))


def multisines(machine: Machine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return alpha (n, m) and ref (n, p) as interleaved odd multisines."""
    r, m, p = machine.recording, len(machine.inputs), len(machine.outputs)
    channels = m + (p if r.reference else 0)
    lines = odd_lines(r.period, r.band, channels, generator)
    alpha = np.column_stack([multisine(lines[i], r.period, t, generator) for i in range(m)])
    if not r.reference:
        return alpha, np.zeros((t.size, p))
    slow = [x[x <= REFERENCE_BAND * r.period] for x in lines[m:]]
    return alpha, np.column_stack([multisine(x, r.period, t, generator) for x in slow])


def sines(machine: Machine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return one sine per input, each at a frequency of its own that repeats with the period, and no reference."""
    r = machine.recording
    top = 0.35 * r.band[1] * r.period
    lines = generator.choice(np.arange(int(0.03 * r.band[1] * r.period) + 1, int(top)), len(machine.inputs), replace=False)
    alpha = [multisine(np.array([k]), r.period, t, generator) for k in lines]
    return np.column_stack(alpha), np.zeros((t.size, len(machine.outputs)))


def operation(machine: Machine, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
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
