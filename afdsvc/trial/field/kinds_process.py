"""Laws inside a process: characteristics, further branches, and constants that are not what the owner believes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.field.law import Law, Spot
from afdsvc.trial.laws import field_codes as f


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
LAWS = (
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
