"""Kinds of laws of the field trials: on commands, inside processes, in sensors, as forces on an axis.

Shapes are drawn at random, sizes follow from the signals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.trial.effect import Effect
from afdsvc.trial.field.rig import Law, Spot
from afdsvc.trial.laws import field as f

FRICTION = ("coulomb_friction", "stribeck_friction")
SUPPLY = 24.0


def _uneven_zone(s: Spot) -> Effect:
    width = 0.1 * s.u
    return s.on_command(f.UNEVEN_ZONE, ("width", width, 1), ("unevenness", s.draw(0.6, 1.5), 0), ("rounding", 0.2 * width, 1))


def _sticky_zone(s: Spot) -> Effect:
    values = ("opens_at", 0.15 * s.u, 1), ("closes_at", s.draw(0.3, 0.6), 0), ("time", 0.2 * s.rig.fast, 0)
    return s.on_command(f.STICKY_ZONE, *values)


def _power_curve(s: Spot) -> Effect:
    return s.on_command(f.POWER_CURVE, ("exponent", 0.1, 1), ("at", 1.2 * s.u, 0))


def _uneven_limit(s: Spot) -> Effect:
    values = ("limit", 2.0 * s.u, -0.4), ("unevenness", s.draw(0.8, 1.3), 0), ("sharpness", s.draw(5.0, 9.0), 0)
    return s.on_command(f.UNEVEN_LIMIT, *values)


def _plays(s: Spot) -> Effect:
    return s.on_command(f.PLAYS, ("share", 0.1, 0.7), ("width", s.draw(0.5, 1.0) * s.u, 0.3), free=(0, 1))


def _soft_play(s: Spot) -> Effect:
    return s.on_command(f.SOFT_PLAY, ("half_width", 0.05 * s.u, 1), ("give", s.draw(0.02, 0.08), 0))


def _grid(s: Spot) -> Effect:
    return s.on_command(f.GRID, ("step", 0.1 * s.u, 1), free=())


def _late(s: Spot) -> Effect:
    return s.on_command(f.LATE, ("delay", 0.05 * s.rig.tau, 1), free=())


def _soft_slew(s: Spot) -> Effect:
    return s.on_command(f.SOFT_SLEW, ("rate", 4.0 * s.u / s.rig.tau, -1), ("corner", s.draw(0.04, 0.1) * s.rig.fast, 0))


def _lame(s: Spot) -> Effect:
    return s.on_command(f.LAME, ("share", 0.05 * s.sign(), 1), ("rounding", 0.05 * s.u, 0))


def _follows(s: Spot) -> Effect:
    return s.on_command(f.FOLLOWS, ("share", 0.05 * s.sign(), 1), ("mean", SUPPLY, 0), ("sd", 0.05 * SUPPLY, 0))


def _two_lags(s: Spot) -> Effect:
    return s.on_command(f.TWO_LAGS, ("time_constant", 0.05 * s.rig.tau, 1), states=2)


def _ringing(s: Spot) -> Effect:
    return s.on_command(f.RINGING, ("frequency", 8.0 / s.rig.tau, -0.7), ("damping_ratio", s.draw(0.05, 0.25), 0), free=(0, 1), states=2)


def _droop(s: Spot) -> Effect:
    values = ("share", 0.1, 1), ("at", s.u, 0), ("time", s.draw(0.3, 1.5) * s.rig.tau, 0)
    return s.on_command(f.DROOP, *values, free=(0, 2), states=1)


def _relaxing(s: Spot) -> Effect:
    return s.on_command(f.RELAXING, ("share", 0.1 * s.sign(), 1), ("time", s.draw(0.5, 1.5) * s.rig.tau, 0), free=(0, 1), states=3)


def _patchy_gain(s: Spot) -> Effect:
    values = ("share", 0.1, 1), ("length", s.draw(0.4, 1.2) * s.travel, 0), ("phase", s.draw(0, 6.28), 0)
    return s.on_command(f.PATCHY_GAIN, *values, free=(0, 1, 2))


def _two_poles(s: Spot) -> Effect:
    return s.on_output(f.TWO_POLES, ("time_constant", 0.05 * s.rig.tau, 1), states=2)


def _clipped(s: Spot) -> Effect:
    values = ("limit", 2.2 * s.y, -0.4), ("unevenness", s.draw(0.8, 1.3), 0), ("sharpness", s.draw(6.0, 12.0), 0)
    return s.on_output(f.CLIPPED, *values)


def _bent(s: Spot) -> Effect:
    return s.on_output(f.BENT, ("share", 0.05 * s.sign(), 1), ("at", s.y, 0))


def _warm_up(s: Spot) -> Effect:
    values = ("drift", 0.05 * s.sign() * s.y, 1), ("time", s.draw(15.0, 40.0) * s.rig.tau, 0)
    return s.on_output(f.WARM_UP, *values, free=(0, 1))


def _crossed(s: Spot) -> Effect:
    return s.on_output(f.CROSSED, ("share", 0.05 * s.sign(), 1))


def _eccentric(s: Spot) -> Effect:
    values = ("size", 0.05 * s.y, 1), ("length", s.draw(0.25, 0.6) * s.y, 0), ("phase", s.draw(0, 6.28), 0)
    return s.on_output(f.ECCENTRIC, *values, free=(0, 1, 2))


def _coarse(s: Spot) -> Effect:
    return s.on_output(f.COARSE, ("step", 0.2 * s.y, 1), free=())


_CURVED = ("static_nonlinearity", "sensor_nonlinearity")
_SLOW = ("actuator_lag", "sensor_lag")
_STRONG = ("quadratic_stiffness", "cubic_stiffness")
COMMAND_LAWS = (
    Law("uneven_zone", "command", _uneven_zone, ("dead_zone",), (*FRICTION, "static_nonlinearity", "backlash")),
    Law("sticky_zone", "command", _sticky_zone, (), ("dead_zone", "hysteresis", "backlash", "static_nonlinearity", *FRICTION)),
    Law("power_curve", "command", _power_curve, ("static_nonlinearity",), ("dead_zone", "saturation", "sensor_nonlinearity"), ("thrust",)),
    Law("uneven_limit", "command", _uneven_limit, ("saturation",), (*_CURVED, "sensor_saturation")),
    Law("plays", "command", _plays, ("hysteresis",), ("backlash", "creep", "dead_zone", "static_nonlinearity"), ("hysteresis", "bouc_wen")),
    Law("soft_play", "command", _soft_play, ("backlash",), ("hysteresis", "dead_zone", "creep"), ("bouc_wen",)),
    Law("grid", "command", _grid, ("quantisation",), ("static_nonlinearity", "dead_zone", "coloured_noise"), ("quantis",)),
    Law("late", "command", _late, ("transport_delay",), (*_SLOW, "resonant_actuator")),
    Law("soft_slew", "command", _soft_slew, ("slew_limit",), (*_SLOW, "saturation", "transport_delay"), ("speed_limit",)),
    Law("lame", "command", _lame, ("static_nonlinearity",), ("sensor_rectification", "sensor_nonlinearity", "constant_load"), ("asymmetric",)),
    Law("follows", "command", _follows, ("gain_follows_aux",), ("static_nonlinearity", "parameter_change", "stiffness_follows_aux")),
    Law("two_lags", "command", _two_lags, _SLOW, ("transport_delay", "resonant_actuator")),
    Law("ringing", "command", _ringing, ("resonant_actuator",), ("flexible_mode", *_SLOW, "transport_delay")),
    Law(
        "droop", "command", _droop, (),
        ("saturation", "static_nonlinearity", "creep", "gain_follows_aux", "hysteresis", "parameter_change"), ("droop", "supply"),
    ),
    Law("relaxing", "command", _relaxing, ("creep",), (*_SLOW, "hysteresis", "sensor_drift")),
    Law(
        "patchy_gain", "command", _patchy_gain, (), (*_STRONG, "static_nonlinearity", "gain_follows_aux", "parameter_change"),
        ("position_dependent",), ("position",),
    ),
    Law("two_poles", "sensor", _two_poles, _SLOW, ("transport_delay", "resonant_actuator"), (), ("steady",)),
    Law("clipped", "sensor", _clipped, ("sensor_saturation",), (*_CURVED, "saturation"), (), ("steady",)),
    Law("bent", "sensor", _bent, ("sensor_nonlinearity",), ("static_nonlinearity", "sensor_rectification", *_STRONG)),
    Law("warm_up", "sensor", _warm_up, ("sensor_drift",), ("sensor_offset", "creep", "constant_load", "coloured_noise"), (), ("steady",)),
    Law("crossed", "sensor", _crossed, ("sensor_crosstalk",), ("sensor_misalignment", "parameter_change"), (), ("pair",)),
    Law(
        "eccentric", "sensor", _eccentric, (), ("runout", "sensor_nonlinearity", "periodic_disturbance", "static_nonlinearity"),
        ("ripple", "eccentric"), ("position",),
    ),
    Law("coarse", "sensor", _coarse, ("quantisation",), ("sensor_nonlinearity", "coloured_noise"), ("quantis",)),
)


def _root(s: Spot) -> Effect:
    return s.inside(f.ROOT, ("head", 8.0 * float(s.sizes.x[s.i]), -1))


def _magnet(s: Spot) -> Effect:
    return s.inside(f.MAGNET, ("gap", 8.0 * float(s.sizes.x[0]), -1))


def _inductance(s: Spot) -> Effect:
    return s.inside(f.INDUCTANCE, ("current", 4.0 * float(s.sizes.x[0]), -0.5))


def _heating(s: Spot) -> Effect:
    values = ("share", 0.1, 1), ("at", float(s.sizes.x[0]), 0), ("time", s.draw(3.0, 12.0) * s.rig.tau, 0)
    return s.inside(f.HEATING, *values, free=(0, 2), states=1)


def _radiation(s: Spot) -> Effect:
    return s.inside(f.RADIATION, ("above", 12.0 * float(s.sizes.x[1]), -1))


def _hard_shaft(s: Spot) -> Effect:
    return s.inside(f.HARD_SHAFT, ("twist", 2.0 * float(s.sizes.x[1]), -0.5))


def _loose_shaft(s: Spot) -> Effect:
    return s.inside(f.LOOSE_SHAFT, ("half_width", 0.2 * float(s.sizes.x[1]), 1))


def _spill(s: Spot) -> Effect:
    size = float(s.sizes.x[s.i])
    return s.inside(f.SPILL, ("rate", 4.0 / s.rig.tau, 0), ("rim", 2.0 * size, -0.4), ("rounding", 0.04 * size, 0), free=(1,))


def _store(s: Spot) -> Effect:
    return s.inside(f.STORE, ("exchange", 0.1 / s.rig.tau, 1), ("fill", s.draw(0.1, 0.5) / s.rig.tau, 0), free=(0, 1), states=1)


def _constant(s: Spot) -> Effect:
    """Return another value of one of the constants the owner is least sure of, up or down."""
    k = int(s.g.choice(np.flatnonzero(s.rig.loose >= 0.3)))
    change = s.effect("machine", f.CONSTANT, (s.rig.names[k], 0.1 * s.sign(), 1), free=())
    return replace(change, parameter=s.rig.names[k], shifts={k: 1.0})


_CURVES = ("static_nonlinearity", "sensor_nonlinearity", "quadratic_stiffness", "quadratic_damping", "saturation", "cubic_stiffness")
PROCESS_LAWS = (
    Law("root", "characteristic", _root, (), (*_CURVES, "parameter_change"), ("outflow", "square_root", "root"), ("tanks",)),
    Law("magnet", "characteristic", _magnet, (), (*_CURVES, "parameter_change"), ("magnet",), ("magnet",)),
    Law("inductance", "characteristic", _inductance, (), (*_CURVES, "parameter_change"), ("inductance", "coil"), ("coil",)),
    Law(
        "heating", "characteristic", _heating, (),
        ("creep", "gain_follows_aux", "sensor_drift", "parameter_change", "hysteresis", *_CURVES), ("heat", "warm", "temperature"), ("coil",),
    ),
    Law("radiation", "characteristic", _radiation, (), (*_CURVES, "parameter_change"), ("radiation", "loss"), ("stores",)),
    Law("hard_shaft", "characteristic", _hard_shaft, ("cubic_stiffness",), ("clearance", "backlash"), ("gear_spring",), ("shaft",)),
    Law("loose_shaft", "characteristic", _loose_shaft, ("backlash", "clearance"), ("dead_zone", "cubic_stiffness", "hysteresis"), (), ("shaft",)),
    Law(
        "spill", "branch", _spill, (), ("saturation", "sensor_saturation", "static_nonlinearity", "sensor_nonlinearity", "clearance"),
        ("overflow", "spill"), ("tanks",),
    ),
    Law(
        "store", "branch", _store, (), ("creep", "actuator_lag", "sensor_lag", "flexible_mode", "parameter_change", "sensor_drift"),
        ("store", "ambient", "pole"), ("still",),
    ),
    Law("constant", "constant", _constant, ("parameter_change",), ("static_nonlinearity", "actuator_lag", "sensor_lag"), (), ("white_box",)),
)


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
