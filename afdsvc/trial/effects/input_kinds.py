"""Physics left out at an actuator: shapes drawn at random, sizes from the signals, one function per canonical name."""

from __future__ import annotations

import numpy as np

from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.effects.site import EffectSite
from afdsvc.trial.laws import codes as c


def input_delay(s: EffectSite) -> Effect:
    """Commands act late."""
    return s.on_input("transport_delay", c.DELAY, ("delay", "s", 0.5 * s.machine.dt, 1))


def actuator_lag(s: EffectSite) -> Effect:
    """One more lag, with a faster second pole."""
    return s.on_input("actuator_lag", c.LAG, ("time_constant", "s", 0.5 * s.machine.dt, 1))


def resonant_actuator(s: EffectSite) -> Effect:
    """The actuator resonates, the lower the more severe."""
    top = 2 * np.pi * s.machine.recording.band[1]
    values = ("frequency", "rad/s", s.draw(0.9, 1.1) * top, -0.5), ("damping_ratio", "1", s.draw(0.03, 0.1), 0)
    return s.on_input("resonant_actuator", c.RESONANCE, *values, free=(0, 1), states=3)


def input_dead_zone(s: EffectSite) -> Effect:
    """Small commands do nothing."""
    width = 0.1 * float(s.sizes.u[s.i])
    return s.on_input("dead_zone", c.DEAD_ZONE, ("half_width", s.unit, width, 1), ("rounding", s.unit, 0.12 * width, 1))


def input_saturation(s: EffectSite) -> Effect:
    """Large commands are cut."""
    limit = 2.5 * float(s.sizes.u[s.i])
    return s.on_input("saturation", c.SATURATION, ("limit", s.unit, limit, -0.25), ("sharpness", "1", s.draw(6, 12), 0))


def input_backlash(s: EffectSite) -> Effect:
    """Play in the drive."""
    return s.on_input("backlash", c.BACKLASH, ("half_width", s.unit, 0.1 * float(s.sizes.u[s.i]), 1))


def input_hysteresis(s: EffectSite) -> Effect:
    """The drive follows on a loop (piezo)."""
    values = _loop(s, float(s.sizes.u[s.i]), s.unit)
    return s.on_input("hysteresis", c.HYSTERESIS, ("share", "1", 0.1, 1), *values, free=(0, 1))


def input_creep(s: EffectSite) -> Effect:
    """The drive goes on moving after a step."""
    return s.on_input("creep", c.CREEP, ("share", "1", 0.1, 1), states=3)


def slew_limit(s: EffectSite) -> Effect:
    """The drive cannot follow fast commands."""
    rate = 0.5 * float(s.sizes.u[s.i]) / s.machine.dt
    values = ("rate", s.unit + "/s", rate, -0.5), ("corner", s.unit, s.draw(0.02, 0.1) * float(s.sizes.u[s.i]), 0)
    return s.on_input("slew_limit", c.SLEW, *values)


def static_nonlinearity(s: EffectSite) -> Effect:
    """The gain grows with the command."""
    values = ("curvature", "1", s.sign() * 0.1, 1), ("at", s.unit, float(s.sizes.u[s.i]), 0)
    return s.on_input("static_nonlinearity", c.STATIC_NONLINEARITY, *values)


def input_gain_follows_aux(s: EffectSite) -> Effect:
    """The actuator's gain follows the supply."""
    k = s.aux("pressure" if "pressure" in s.machine.aux else "supply")
    values = following(s, k)
    return s.on_input("gain_follows_aux", c.GAIN_FOLLOWS_AUX, *values, extra=(k,))


def input_tone(s: EffectSite) -> Effect:
    """Hum on the actuator."""
    return s.on_input("periodic_disturbance", c.PERIODIC, *tone(s, 0.1 * float(s.sizes.u[s.i]), s.unit), free=(0, 1, 2))


def input_memory_polynomial(s: EffectSite) -> Effect:
    """Products of the command now and a moment ago: not in the vocabulary."""
    lag = 3.0 / (2 * np.pi * s.machine.recording.band[1]) * s.draw(1, 3)
    values = ("share", "1", s.sign() * 0.1, 1), ("at", s.unit, float(s.sizes.u[s.i]), 0), ("lag", "s", lag, 0)
    return s.on_input("memory_polynomial", c.MEMORY_POLYNOMIAL, *values, states=1)


def _loop(s: EffectSite, size: float, unit: str) -> tuple[tuple[str, str, float, float], ...]:
    """Return width, exponent and skew of a Bouc-Wen loop for motion of this size."""
    width = s.draw(0.3, 0.6) * size
    return ("width", unit, width, 0), ("exponent", "1", s.draw(1.4, 1.8), 0), ("skew", "1", s.draw(0.45, 0.6), 0)


def following(s: EffectSite, k: int) -> tuple[tuple[str, str, float, float], ...]:
    """Return how something follows auxiliary signal k: share per standard deviation, mean, standard deviation."""
    mean, sd = float(s.sizes.aux_mean[k]), float(s.sizes.aux_sd[k])
    return ("share", "1", s.sign() * 0.1, 1), ("mean", "", mean, 0), ("sd", "", sd, 0)


def tone(s: EffectSite, size: float, unit: str) -> tuple[tuple[str, str, float, float], ...]:
    """Return a tone: the mains (never quite 50 Hz) or a neighbouring machine at any frequency."""
    low, high = s.machine.recording.band
    mains = 50.0 + s.draw(-0.06, 0.06)
    hertz = mains if s.generator.random() < 0.5 else s.draw(max(8 * low, 5.0), 0.3 * high)
    return ("amplitude", unit, size, 1), ("frequency", "rad/s", 2 * np.pi * hertz, 0), ("phase", "rad", s.phase(), 0)
