"""Kinds of hidden physics: at an actuator, in the balance of forces, in a sensor; one function per canonical name.

Shapes are drawn at random, sizes follow from the signals.
"""

from __future__ import annotations

import numpy as np

from afdsvc.trial.effect import Effect
from afdsvc.trial.laws import scalar as c
from afdsvc.trial.site import EffectSite


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


def coulomb_friction(s: EffectSite) -> Effect:
    """Dry friction."""
    values = ("force", s.force, 0.1 * s.push, 1), ("rounding", s.rate, 0.04 * s.speed, 0)
    return s.on_axis("coulomb_friction", c.COULOMB, *values)


def stribeck_friction(s: EffectSite) -> Effect:
    """Dry friction, higher at rest."""
    values = (
        ("force", s.force, 0.1 * s.push, 1),
        ("rounding", s.rate, 0.04 * s.speed, 0),
        ("rest_ratio", "1", s.draw(2.2, 3.0), 0),
        ("stribeck_velocity", s.rate, s.draw(0.4, 0.8) * s.speed, 0),
    )
    return s.on_axis("stribeck_friction", c.STRIBECK, *values, free=(0, 2, 3))


def axis_quadratic_damping(s: EffectSite) -> Effect:
    """Drag with the square of velocity."""
    values = ("coefficient", "", 0.05 * s.push / s.speed**2, 1), ("rounding", s.rate, 0.1 * s.speed, 0)
    return s.on_axis("quadratic_damping", c.QUADRATIC_DAMPING, *values)


def cubic_stiffness(s: EffectSite) -> Effect:
    """Hardening."""
    values = ("coefficient", "", 0.02 * s.push / s.travel**3, 1), ("fifth_order_at", s.length, 2.5 * s.travel, 0)
    return s.on_axis("cubic_stiffness", c.CUBIC, *values)


def quadratic_stiffness(s: EffectSite) -> Effect:
    """Stiffer on one side."""
    values = ("coefficient", "", s.sign() * 0.03 * s.push / s.travel**2, 1), ("third_order_at", s.length, 2.5 * s.travel, 0)
    return s.on_axis("quadratic_stiffness", c.QUADRATIC, *values)


def clearance(s: EffectSite) -> Effect:
    """Contact beyond a gap."""
    gap = s.draw(1.2, 1.6) * s.travel
    values = ("stiffness", "", 0.1 * s.push / s.travel**1.5, 1), ("gap", s.length, gap, 0), ("rounding", s.length, 0.05 * gap, 0)
    return s.on_axis("clearance", c.CLEARANCE, *values, free=(0, 1))


def constant_load(s: EffectSite) -> Effect:
    """A weight, as good as constant."""
    return s.on_axis("constant_load", c.CONSTANT_LOAD, ("force", s.force, s.sign() * 0.1 * s.push, 1))


def axis_tone(s: EffectSite) -> Effect:
    """A neighbour shakes the axis."""
    return s.on_axis("periodic_disturbance", c.PERIODIC_FORCE, *tone(s, 0.1 * s.push, s.force), free=(0, 1, 2))


def axis_hysteresis(s: EffectSite) -> Effect:
    """An elastic-plastic force."""
    values = (
        ("force", s.force, 0.1 * s.push, 1),
        ("width", s.length, s.draw(0.2, 0.5) * s.travel, 0),
        ("exponent", "1", s.draw(1.4, 1.8), 0),
        ("skew", "1", s.draw(0.45, 0.6), 0),
    )
    return s.on_axis("hysteresis", c.HYSTERETIC_FORCE, *values, free=(0, 1), states=1)


def axis_flexible_mode(s: EffectSite) -> Effect:
    """Something hangs on the axis and swings."""
    top = s.machine.recording.band[1]
    hertz = s.draw(0.1, 0.27) * top if s.generator.random() < 0.5 else s.draw(0.45, 0.75) * top
    values = (
        ("mass_ratio", "1", 0.02, 1),
        ("frequency", "rad/s", 2 * np.pi * hertz, 0),
        ("damping_ratio", "1", s.draw(0.008, 0.03), 0),
        ("hardening_at", s.length, 3.0 * s.travel, 0),
    )
    return s.on_axis("flexible_mode", c.FLEXIBLE_MODE, *values, free=(0, 1, 2), states=2)


def gyroscopic_coupling(s: EffectSite) -> Effect:
    """The turning rotor couples the velocities."""
    _, speed, push = s.means
    ratio = s.sign() * 0.1 * push / (speed * s.turning)
    return s.effect("gyroscopic_coupling", c.GYROSCOPIC, (*s.both, s.aux("speed")), ("ratio", "1", ratio, 1))


def cross_coupled_stiffness(s: EffectSite) -> Effect:
    """The swirling film couples the positions."""
    travel, _, push = s.means
    values = ("stiffness", "1/s^2", s.sign() * 0.1 * push / travel, 1), ("at_speed", "rad/s", s.turning, 0)
    return s.effect("cross_coupled_stiffness", c.CROSS_COUPLED, (*s.both, s.aux("speed")), *values)


def rotor_unbalance(s: EffectSite) -> Effect:
    """The rotor's mass is off its centre."""
    values = ("eccentricity", s.length, 0.1 * s.means[2] / s.turning**2, 1), ("phase", "rad", s.phase(), 0)
    places = (*s.both, s.aux("speed"), s.aux("angle"))
    return s.effect("unbalance", c.UNBALANCE, places, *values, free=(0, 1))


def stiffness_follows_aux(s: EffectSite) -> Effect:
    """The film's stiffness follows the supply pressure, on every axis."""
    stiffness = s.sizes.push / s.sizes.q
    values = [*following(s, s.aux("pressure")), ("stiffness_1", "1/s^2", float(stiffness[0]), 0)]
    if stiffness.size > 1:
        values.append(("stiffness_2", "1/s^2", float(stiffness[1]), 0))
    return s.effect("stiffness_follows_aux", c.STIFFNESS_FOLLOWS_AUX, (*s.both, s.aux("pressure")), *values)


def parametric_stiffness(s: EffectSite) -> Effect:
    """Stiffness modulated at a frequency of its own: not in the vocabulary."""
    values = (
        ("share", "1", 0.1, 1),
        ("frequency", "rad/s", 2 * np.pi * s.draw(0.04, 0.12) * s.machine.recording.band[1], 0),
        ("phase", "rad", s.phase(), 0),
        ("stiffness", "1/s^2", s.push / s.travel, 0),
    )
    return s.effect("parametric_stiffness", c.PARAMETRIC, s.along, *values, free=(0, 1, 2))


def bilinear_coupling(s: EffectSite) -> Effect:
    """A command modulates the damping of the axis: not in the vocabulary."""
    other = len(s.machine.inputs) - 1 - s.axis.input
    values = ("rate", "1/s", s.sign() * 0.1 * s.push / s.speed, 1), ("at", s.machine.inputs[other].unit, float(s.sizes.u[other]), 0)
    return s.effect("bilinear_coupling", c.BILINEAR, (*s.along, 0, 0, other), *values)


def axis_fractional_damping(s: EffectSite) -> Effect:
    """Force with the half derivative of position (viscoelastic): not in the vocabulary."""
    scale = np.sqrt(s.speed / s.travel) * s.travel
    return s.on_axis("fractional_damping", c.FRACTIONAL, ("coefficient", "", 0.1 * s.push / scale, 1), states=8)


def stick_slip_events(s: EffectSite) -> Effect:
    """A contact that grips, stretches and lets go at random: not in the vocabulary."""
    stretch = s.draw(0.5, 1.0) * s.travel
    values = (
        ("stiffness", "", 0.1 * s.push / s.travel, 1),
        ("stretch", s.length, stretch, 0),
        ("seed", "", float(s.generator.integers(1, 2**31 - 2)), 0),
    )
    return s.on_axis("stick_slip_events", c.STICK_SLIP, *values)


def output_delay(s: EffectSite) -> Effect:
    """Readings come late."""
    return s.on_output("transport_delay", c.SENSOR_DELAY, ("delay", "s", 0.5 * s.machine.dt, 1))


def sensor_lag(s: EffectSite) -> Effect:
    """The sensor's low-pass, with a faster second pole."""
    return s.on_output("sensor_lag", c.SENSOR_LAG, ("time_constant", "s", 0.5 * s.machine.dt, 1))


def sensor_crosstalk(s: EffectSite) -> Effect:
    """One sensor sees some of the other direction."""
    return s.on_output("sensor_crosstalk", c.CROSSTALK, ("share", "1", s.sign() * 0.05, 1), extra=(1 - s.i,))


def sensor_misalignment(s: EffectSite) -> Effect:
    """The pair of sensors is turned about the shaft."""
    return s.effect("sensor_misalignment", c.MISALIGNMENT, (0, 1), ("angle", "rad", s.sign() * 0.05, 1))


def sensor_offset(s: EffectSite) -> Effect:
    """The zero is off."""
    return s.on_output("sensor_offset", c.OFFSET, ("offset", s.unit, s.sign() * 0.2 * float(s.sizes.y[s.i]), 1))


def sensor_drift(s: EffectSite) -> Effect:
    """The zero moves while it warms up."""
    length = s.machine.recording.period * s.machine.recording.periods
    values = ("drift", s.unit, s.sign() * 0.3 * float(s.sizes.y[s.i]), 1), ("time_constant", "s", s.draw(0.5, 1.2) * length, 0)
    return s.on_output("sensor_drift", c.DRIFT, *values, free=(0, 1))


def sensor_nonlinearity(s: EffectSite) -> Effect:
    """The sensor's curve bends."""
    values = ("curvature", "1", s.sign() * 0.1, 1), ("at", s.unit, float(s.sizes.y[s.i]), 0)
    return s.on_output("sensor_nonlinearity", c.SENSOR_NONLINEARITY, *values)


def sensor_rectification(s: EffectSite) -> Effect:
    """The sensor is steeper on one side."""
    values = ("share", "1", s.sign() * 0.1, 1), ("rounding", s.unit, 0.05 * float(s.sizes.y[s.i]), 0)
    return s.on_output("sensor_rectification", c.RECTIFICATION, *values)


def sensor_saturation(s: EffectSite) -> Effect:
    """The sensor ends."""
    limit = 2.5 * float(s.sizes.y[s.i])
    return s.on_output("sensor_saturation", c.SENSOR_SATURATION, ("limit", s.unit, limit, -0.25), ("sharpness", "1", s.draw(6, 12), 0))


def quantisation(s: EffectSite) -> Effect:
    """The reading moves in steps."""
    step = float(s.machine.sigma[s.i])
    values = ("step", s.unit, step, 1), ("grid", s.unit, s.draw(0, 1) * step, 1)
    return s.effect("quantisation", c.QUANTISATION, (s.i,), *values)


def runout(s: EffectSite) -> Effect:
    """The surface the sensor looks at is not round."""
    values = (
        ("amplitude", s.unit, 0.2 * float(s.sizes.y[s.i]), 1),
        ("phase", "rad", s.phase(), 0),
        ("second", "1", s.draw(0.3, 0.6), 0),
        ("second_phase", "rad", s.phase(), 0),
        ("third", "1", s.draw(0.2, 0.4), 0),
    )
    return s.on_output("runout", c.RUNOUT, *values, extra=(s.aux("angle"),), free=(0, 1, 2, 3, 4))


def output_tone(s: EffectSite) -> Effect:
    """Hum in the sensor."""
    return s.on_output(
        "periodic_disturbance", c.PERIODIC_SENSED, *tone(s, 0.1 * float(s.sizes.y[s.i]), s.unit), free=(0, 1, 2)
    )


def output_gain_follows_aux(s: EffectSite) -> Effect:
    """The sensor's gain follows the temperature."""
    k = s.aux("temperature")
    return s.on_output("gain_follows_aux", c.SENSED_GAIN_FOLLOWS_AUX, *following(s, k), extra=(k,))


def coloured_noise(s: EffectSite) -> Effect:
    """The sensor's noise has a coloured part."""
    return s.effect("coloured_noise", c.NOISE, (s.i,), ("rms", s.unit, float(s.machine.sigma[s.i]), 1), free=())
