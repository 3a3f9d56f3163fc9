"""Laws that shift the phase of many periods: what they promise to first order holds over a small part of the way."""

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, SAMPLES, SUBSTEPS = 0.01, 3000, 10
K, D, SUPPORT, STATED = 400.0, 0.12, 200.0, 520.0  # 1/s^2, 1/s; the support acts below zero, beside it the model is 8 % off


def decay(seed: int) -> Trace:
    """Return 100 periods of a beam that touches a support below zero (Runge-Kutta)."""
    rng = np.random.default_rng(seed)
    x, seen, h = np.array([10.0 + seed, 0.0]), [], DT / SUBSTEPS

    def rate(x):
        return np.array([x[1], -K * x[0] - SUPPORT * min(x[0], 0.0) - D * x[1]])

    for _ in range(SAMPLES):
        seen.append(x[0])
        for _ in range(SUBSTEPS):
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
    return Trace(f"r{seed}", DT, (Channel("y_tip", "mm"),), (np.array(seen) + 0.02 * rng.standard_normal(SAMPLES))[:, None])


def test_a_support_that_a_beam_touches_at_rest_is_found_in_its_decay():
    plant = StateSpace(np.array([[0, 1.0], [-STATED, -0.1]]), np.zeros((2, 0)), np.array([[1.0, 0]]), np.zeros((1, 0)))
    sd = {"A": 0.15 * np.abs(plant.A) * (np.abs(plant.A) != 1)}
    model = Model("beam", (), (Variable("tip", "mm"),), (Variable("tip", "mm"), Variable("v", "mm/s", rate_of="tip")), plant, entry_sd=sd)
    names = ("clearance", "quadratic_stiffness", "cubic_stiffness", "sensor_nonlinearity", "sensor_rectification", "relaxation", "periodic_disturbance")
    found = explain(model, [decay(1), decay(2)], [decay(3)], [p for p in afdsvc_physics() if p.name in names], experiment=False)
    (named,) = found.named
    assert (named.physics, named.site) == ("clearance", "state:v")
    assert abs(named.parameters["stiffness"].value) == pytest.approx(SUPPORT, rel=0.03)
    assert found.fit[0].after_nrmse < 0.02
