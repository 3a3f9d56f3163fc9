"""Physics left out in the balance of forces: on one axis, between axes, or from the rotor."""

from __future__ import annotations

import numpy as np

from afdsvc.trial.effects.effect import Effect
from afdsvc.trial.effects.input_kinds import following, tone
from afdsvc.trial.effects.site import EffectSite
from afdsvc.trial.laws import codes as c


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
