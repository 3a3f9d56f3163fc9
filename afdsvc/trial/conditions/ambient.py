"""What happens around a machine while it is recorded: rotor speed and angle, supply, pressure, temperature; and noise."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from afdsvc.lti.statespace import Array
from afdsvc.trial.machines.machine import Machine

UNITS = {"speed": "rad/s", "angle": "rad", "pressure": "bar", "temperature": "degC", "supply": "V"}


def wandering(t: Array, generator: np.random.Generator) -> Array:
    """Return a slow signal of unit rms: five sines of 0.6 to 5 periods over the record, random phases."""
    span = t[-1] - t[0]
    turns = np.geomspace(0.6, 5.0, 5) * generator.uniform(0.85, 1.15, 5)
    phases = generator.uniform(0, 2 * np.pi, 5)
    x = np.sin(2 * np.pi * np.outer((t - t[0]) / span, turns) + phases).sum(axis=1)
    return np.asarray((x - x.mean()) / x.std())


def ambient(machine: Machine, speed: float, t: Array, generator: np.random.Generator) -> Array:
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


def sensor_noise(machine: Machine, kind: str, samples: int, generator: np.random.Generator) -> Array:
    """Return the sensors' noise, shape ``(samples, p)``; ``kind`` white, coloured (equal variance), quieter or louder."""
    factor = {"quieter": 0.5, "louder": 2.0}.get(kind, 1.0)
    white = generator.standard_normal((samples, machine.sigma.size))
    unit = coloured(white, 0.8) if kind == "coloured" else white
    return factor * machine.sigma * unit


def coloured(white: Array, pole: float) -> Array:
    """Return noise of unit variance through a first-order low-pass with this pole."""
    return np.asarray(lfilter([np.sqrt(1 - pole * pole)], [1.0, -pole], white, axis=0))
