"""Physics left out at a sensor."""

from __future__ import annotations

from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.effects.input_kinds import following, tone
from afdsvc.trial.effects.site import EffectSite
from afdsvc.trial.laws import codes as c


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
