"""Laws that are forces on an axis: shapes drawn at random, sizes from the signals."""

from __future__ import annotations

from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.field.kinds_motion import FRICTION
from afdsvc.trial.field.law import Law, Spot
from afdsvc.trial.laws import field_codes as f


def _dry(s: Spot) -> Effect:
    return s.on_axis(f.DRY, ("force", 0.1 * s.push, 1), ("rounding", 0.03 * s.speed, 0), ("unevenness", s.draw(0.6, 1.0), 0), free=(0, 2))


def _stribeck(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("rounding", 0.03 * s.speed, 0), ("rest", s.draw(1.5, 2.5), 0)
    return s.on_axis(f.STRIBECK, *values, ("speed", s.draw(0.2, 0.6) * s.speed, 0), free=(0, 2, 3))


def _warming(s: Spot) -> Effect:
    values = ("force", 0.2 * s.push, 1), ("rounding", 0.03 * s.speed, 0), ("loss", s.draw(0.8, 1.2), 0)
    return s.on_axis(f.WARMING, *values, ("at", 0.5 * s.speed, 0), ("time", s.draw(8.0, 25.0) * s.rig.tau, 0), free=(0, 2, 4), states=1)


def _pressed(s: Spot) -> Effect:
    return s.on_axis(f.PRESSED, ("share", 0.1, 1), ("rounding", 0.03 * s.speed, 0), ("preload", s.push, 0))


def _bristle(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("reach", s.draw(0.05, 0.25) * s.speed * s.rig.fast, 0)
    return s.on_axis(f.BRISTLE, *values, ("rest", s.draw(0.2, 0.8), 0), ("speed", s.draw(0.2, 0.6) * s.speed, 0), free=(0, 1), states=1)


def _patchy(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("rounding", 0.03 * s.speed, 0), ("share", s.draw(0.6, 0.95), 0)
    return s.on_axis(f.PATCHY, *values, ("length", s.draw(0.3, 0.8) * s.travel, 0), ("phase", s.draw(0, 6.28), 0), free=(0, 2, 4))


def _bouc_wen(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("width", s.draw(0.2, 0.6) * s.travel, 0)
    return s.on_axis(f.BOUC_WEN, *values, ("exponent", s.draw(1.2, 1.8), 0), ("skew", s.draw(0.4, 0.65), 0), free=(0, 1), states=1)


def _drag(s: Spot) -> Effect:
    return s.on_axis(f.DRAG, ("coefficient", 0.05 * s.push / s.speed**2, 1), ("at", s.speed, 0))


def _slow_drag(s: Spot) -> Effect:
    return s.on_axis(f.SLOW_DRAG, ("coefficient", 0.05 * s.push / s.speed**1.5, 1))


def _one_way(s: Spot) -> Effect:
    return s.on_axis(f.ONE_WAY, ("coefficient", 0.1 * s.push / s.speed, 1), ("rounding", 0.1 * s.speed, 0))


def _emf(s: Spot) -> Effect:
    return s.on_axis(f.EMF, ("share", 0.5 * float(s.rig.nominal[1]), 0), ("at", 3.0 * s.speed, -0.5), free=(0, 1))


def _speed_limit(s: Spot) -> Effect:
    return s.on_axis(f.SPEED_LIMIT, ("brake", 3.0 / s.rig.fast, 0), ("limit", 2.0 * s.speed, -0.4), ("rounding", 0.1 * s.speed, 0), free=(1,))


def _hardening(s: Spot) -> Effect:
    return s.on_axis(f.HARDENING, ("force", 0.1 * s.push, 1), ("length", s.draw(0.8, 1.2) * s.travel, 0))


def _leaning(s: Spot) -> Effect:
    return s.on_axis(f.LEANING, ("force", 0.1 * s.push, 1), ("length", s.sign() * s.draw(1.5, 3.0) * s.travel, 0))


def _gap(s: Spot) -> Effect:
    gap = s.draw(0.9, 1.3) * s.travel
    return s.on_axis(f.GAP, ("stiffness", 0.3 * s.push / s.travel**1.3, 1), ("gap", gap, 0), ("rounding", 0.05 * gap, 0), free=(0, 1))


def _weight(s: Spot) -> Effect:
    return s.on_axis(f.WEIGHT, ("force", 0.2 * s.push, 1), ("per_length", s.draw(0.7, 1.1) / s.travel, 0), ("attitude", s.draw(-0.5, 0.5), 0))


def _ripple(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("per_length", s.draw(3.0, 9.0) / (s.speed * s.rig.tau), 0), ("phase", s.draw(0, 6.28), 0)
    return s.on_axis(f.RIPPLE, *values, free=(0, 2))


def _rider(s: Spot) -> Effect:
    values = ("mass_ratio", 0.05, 1), ("frequency", s.draw(0.6, 2.0) / s.rig.fast, 0), ("damping_ratio", s.draw(0.01, 0.06), 0)
    return s.on_axis(f.RIDER, *values, free=(0, 1, 2), states=2)


def _load(s: Spot) -> Effect:
    return s.on_axis(f.LOAD, ("force", 0.1 * s.push * s.sign(), 1), ("time", 7.0 * s.rig.tau, 0))


def _tone(s: Spot) -> Effect:
    values = ("force", 0.1 * s.push, 1), ("frequency", s.draw(1.0, 5.0) / s.rig.tau, 0), ("phase", s.draw(0, 6.28), 0)
    return s.on_axis(f.TONE, *values, free=(0, 2))


_RUBS = (*FRICTION, "hysteresis", "dead_zone", "constant_load", "static_nonlinearity")
_SPRINGS = ("cubic_stiffness", "quadratic_stiffness")
_SPEEDS = ("quadratic_damping", "static_nonlinearity", "saturation", "coulomb_friction", "parameter_change")
LAWS = (
    Law("dry", "axis", _dry, ("coulomb_friction",), (*_RUBS[1:], "sensor_offset", "backlash"), ("coulomb",)),
    Law("stribeck", "axis", _stribeck, ("stribeck_friction",), (*FRICTION[:1], *_RUBS[2:], "sensor_offset", "backlash"), ("stribeck",)),
    Law("warming", "axis", _warming, (), (*_RUBS, "parameter_change")),
    Law("pressed", "axis", _pressed, (), (*_RUBS, "parameter_change"), ("load_dependent", "load_friction")),
    Law("bristle", "axis", _bristle, (), (*_RUBS, "backlash"), ("lugre", "presliding", "dahl", "bristle")),
    Law("patchy", "axis", _patchy, (), (*_RUBS, "parameter_change"), ("position_dependent", "position_friction"), ("position",)),
    Law("bouc_wen", "axis", _bouc_wen, ("hysteresis",), (*FRICTION, "backlash", "parameter_change"), ("bouc_wen", "hysteresis"), ("position",)),
    Law("drag", "axis", _drag, ("quadratic_damping",), _SPEEDS[1:], ("drag",)),
    Law("slow_drag", "axis", _slow_drag, (), _SPEEDS, ("drag",)),
    Law("one_way", "axis", _one_way, (), (*_SPEEDS, "constant_load", "stribeck_friction", "sensor_rectification"), ("direction", "asymmetric")),
    Law("emf", "axis", _emf, (), _SPEEDS, ("emf", "field_weakening"), ("open_motor",)),
    Law("speed_limit", "axis", _speed_limit, (), (*_SPEEDS, "slew_limit"), ("speed_limit", "velocity_limit"), ("firmware",)),
    Law("hardening", "axis", _hardening, ("cubic_stiffness",), ("clearance", "static_nonlinearity", "sensor_nonlinearity"), (), ("spring",)),
    Law("leaning", "axis", _leaning, ("quadratic_stiffness",), ("cubic_stiffness", "static_nonlinearity", "sensor_nonlinearity"), (), ("spring",)),
    Law("gap", "axis", _gap, ("clearance",), ("cubic_stiffness", "saturation", "sensor_saturation"), (), ("spring",)),
    Law("weight", "axis", _weight, (), (*_SPRINGS, "constant_load", "static_nonlinearity", "parameter_change"), ("gravity", "sine"), ("lever",)),
    Law("ripple", "axis", _ripple, (), ("periodic_disturbance", "unbalance", "runout", "clearance"), ("cogging", "ripple"), ("turning",)),
    Law("rider", "axis", _rider, ("flexible_mode",), ("resonant_actuator", "sensor_lag", "actuator_lag"), ("flexible", "mass"), ("inertia",)),
    Law("load", "axis", _load, ("constant_load", "sensor_offset"), ("parameter_change", "sensor_drift")),
    Law("tone", "axis", _tone, ("periodic_disturbance",), ("coloured_noise", "unbalance")),
)
