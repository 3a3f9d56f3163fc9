"""The picture of a law covers the law that is there, and the places name the right band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.physics import Signal
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.locate.free_law import curve, site
from afdsvc.explain.locate.picture import picture
from afdsvc.explain.locate.places import band
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.search.forward import search
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics.clock_offset import ClockOffset
from afdsvc.plugins.physics.coulomb_friction import CoulombFriction
from afdsvc.plugins.physics.cubic_stiffness import CubicStiffness
from afdsvc.plugins.physics.dead_zone import DeadZone
from afdsvc.plugins.physics.quadratic_damping import QuadraticDamping
from afdsvc.testing.conformance.physics import machines


def found(spring, recorded, extra, library):
    runs = prepare(spring, [recorded(k, level, extra) for k, level in enumerate((1.0, 0.6))])
    return search(settled(build(nominal(spring, runs[0].dt), runs, replace(Settings(), effects=1))), library)


def test_a_law_is_drawn_along_the_signal_that_it_was_fitted_along():
    machine = machines()[6]
    (like,) = (h for h in CubicStiffness().hypotheses(machine) if h.key == "cubic_stiffness@state:v1")
    for along in (None, Signal("u", 0)):
        drawn = site(replace(like, along=along), machine, np.linspace(-1e-4, 1e-4, 500))
        assert drawn is not None
        assert drawn.hypothesis.along == along


def test_the_band_holds_the_spring_that_is_there_beside_its_name(spring, recorded):
    answer = found(spring, recorded, lambda q, v: -600.0 * q**3, [CubicStiffness()])
    law = picture(answer, list(answer.end.values())[-1], True)
    assert (law.site, law.against, law.unit, law.x_unit) == ("force on v", "q", "N", "mm")
    true = -0.06 * law.x**3
    linear = np.polyfit(law.x, law.y - true, 1)  # a linear part belongs to the model's own stiffness
    inside = np.abs(law.y - true - np.polyval(linear, law.x)) < 1.5 * (law.high - law.y) + 0.1 * np.abs(true).max()
    assert inside.all()
    assert law.named_y == pytest.approx(true, abs=0.15 * np.abs(true).max())


def test_without_a_name_the_picture_is_drawn_at_the_nearest_site(spring, recorded):
    answer = found(spring, recorded, lambda q, v: -0.05 * v * abs(v), [QuadraticDamping()])
    law = picture(answer, list(answer.start.values())[-1], False)
    assert law.against == "v"
    assert law.named_y is None
    assert "changes sign with the direction" in law.sentence


def rubbing(gain: float, **sd) -> tuple[np.ndarray, str, np.ndarray]:
    """Return where the motor moves, the sentence, and both curves of the friction that is drawn: 0.5 V, gain 50; the model states ``gain``."""
    rng, dt, v = np.random.default_rng(3), 0.01, [0.0]
    u = np.repeat(rng.uniform(-9, 9, 100), 20)
    for now in u[:-1]:
        speed = v[-1]
        for _ in range(20):
            speed += dt / 20 * (50 * now - 5 * speed - 25 * np.tanh(speed / 0.05))
        v.append(speed)
    trace = Trace("log", dt, (Channel("u_voltage"), Channel("y_speed")), np.column_stack([u, np.array(v) + 0.05 * rng.standard_normal(len(u))]))
    plant, axis = StateSpace(np.array([[-5.5]]), np.array([[gain]]), np.array([[1.0]]), np.zeros((1, 1))), (Variable("speed", "rad/s"),)
    model = Model("motor", (Variable("voltage", "V"),), axis, axis, plant, **sd)
    answer = search(settled(build(nominal(model, dt), prepare(model, [trace]), replace(Settings(), effects=1))), [CoulombFriction()])
    law = picture(answer, list(answer.end.values())[-1], True)
    fast = np.abs(law.x) > 0.1 * law.x.max()
    return -0.5 * np.sign(law.x[fast]), law.sentence, np.array([law.y[fast], law.named_y[fast]])


def test_dry_friction_of_a_machine_with_a_speed_alone_is_drawn_even_in_both_directions():
    """An offset of the sensor acts on a first-order machine as a constant force does: it is not the law's to move."""
    true, sentence, (free, _) = rubbing(48.0)
    assert free == pytest.approx(true, abs=0.06)
    assert "same size at every value of the speed, changes sign" in sentence


def test_the_picture_is_in_the_unit_of_the_refitted_gain():
    """A gain stated 30 % too low: the curve of the named force is the force that is named."""
    true, _, (_, named) = rubbing(35.0, entry_sd={"A": np.array([[1.0]]), "B": np.array([[15.0]])})
    assert named == pytest.approx(true, abs=0.02)


def test_a_clock_is_no_curve():
    motor = machines()[2]
    (late,) = ClockOffset().hypotheses(motor)
    assert site(late, motor, np.arange(9.0)) is None
    (zone, *_) = DeadZone().hypotheses(motor)
    assert site(zone, motor, np.arange(9.0)) is not None


def test_the_curve_is_straight_between_its_knots_and_continues_outwards():
    p = np.array([-1.0, 0.0, 2.0, 3.0, 1.0, 5.0])

    def at(x: float) -> float:
        out = np.zeros(1)
        curve(p, np.array([x]), np.zeros(0), 1e-3, out)
        return float(out[0])

    assert [at(x) for x in (-2.0, -1.0, -0.5, 0.0, 1.0, 2.0, 3.0)] == pytest.approx([5, 3, 2, 1, 3, 5, 7])


def test_the_band_of_a_signal_holds_its_power():
    t = np.arange(5000) * 1e-3
    low, high = band(np.sin(2 * np.pi * 20 * t) + np.sin(2 * np.pi * 60 * t), 1e-3)
    assert (low, high) == pytest.approx((20, 60), abs=0.5)
