"""Laws that shift the phase of many periods: what they promise to first order holds over a small part of the way."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.pipeline import explain
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import Fit, fit, rms, weighted
from afdsvc.explain.search.machine import machine
from afdsvc.explain.search.path import _begin
from afdsvc.explain.search.problem import Problem
from afdsvc.explain.search.screen import Screen, Start
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics
from afdsvc.plugins.physics.clearance import Clearance

DT, SAMPLES, SUBSTEPS = 0.01, 3000, 10
K, D, SUPPORT, STATED = 400.0, 0.12, 200.0, 520.0  # 1/s^2, 1/s; the support acts below zero, beside it the model is 8 % off


def decay(seed: int, support: float = SUPPORT) -> Trace:
    """Return 100 periods of a beam that touches a support below zero (Runge-Kutta)."""
    rng = np.random.default_rng(seed)
    x, seen, h = np.array([10.0 + seed, 0.0]), [], DT / SUBSTEPS

    def rate(x):
        return np.array([x[1], -K * x[0] - support * min(x[0], 0.0) - D * x[1]])

    for _ in range(SAMPLES):
        seen.append(x[0])
        for _ in range(SUBSTEPS):
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
    return Trace(f"r{seed}", DT, (Channel("y_tip", "mm"),), (np.array(seen) + 0.02 * rng.standard_normal(SAMPLES))[:, None])


def beam() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-STATED, -0.1]]), np.zeros((2, 0)), np.array([[1.0, 0]]), np.zeros((1, 0)))
    sd = {"A": 0.15 * np.abs(plant.A) * (np.abs(plant.A) != 1)}
    return Model("beam", (), (Variable("tip", "mm"),), (Variable("tip", "mm"), Variable("v", "mm/s", rate_of="tip")), plant, entry_sd=sd)


def screened(support: float) -> tuple[Problem, Fit, Start]:
    """Return the beam refitted without a support, and what the screen promises of one."""
    problem = build(nominal(beam(), DT), prepare(beam(), [decay(1, support)]), Settings())
    mean = (2 / (K**-0.5 + (K + support) ** -0.5)) ** 2  # stiffness of a line with the same period
    base = fit(problem, replace(problem.start(), theta=np.array([(STATED - mean) / (0.15 * STATED), 0.0])), 0.0, 1.0)
    offers = {h.key: h for h in Clearance().hypotheses(machine(problem, base, 0.0))}
    return problem, base, Screen(problem, base, 0.0)(offers["clearance@state:v#stop below"]).starts[0]


def test_a_small_effect_promises_what_it_gains():
    """Oracle: the noise is what it leaves. A step as large as an effect may be would turn the phase by whole periods."""
    problem, base, start = screened(5.0)
    left = (0.02 / problem.scale[0] / base.sd[0]) ** 2
    assert left < 0.9
    assert start.fall == pytest.approx((1 - left) * SAMPLES, rel=0.1)


def test_a_fit_begins_at_a_part_of_what_is_promised_where_all_of_it_costs_more():
    problem, base, start = screened(SUPPORT)
    parts = [rms(weighted(problem, base.point.added(start.effect), 0.0))[0], rms(weighted(problem, _begin(problem, base, start, 0.0), 0.0))[0]]
    assert parts[0] > base.sd[0] > parts[1]


def test_a_support_that_a_beam_touches_at_rest_is_found_in_its_decay():
    names = ("clearance", "quadratic_stiffness", "cubic_stiffness", "sensor_nonlinearity", "sensor_rectification", "relaxation", "periodic_disturbance")
    found = explain(beam(), [decay(1), decay(2)], [decay(3)], [p for p in afdsvc_physics() if p.name in names], experiment=False)
    (named,) = found.named
    assert (named.physics, named.site) == ("clearance", "state:v")
    assert abs(named.parameters["stiffness"].value) == pytest.approx(SUPPORT, rel=0.03)
    assert found.fit[0].after_nrmse < 0.02
