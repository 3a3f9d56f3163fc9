"""Inputs that are held between samples, but look smooth to the model that lacks something: half a sample of delay is not to be named for it."""

from __future__ import annotations

import numpy as np

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT = 0.01
PLANT = StateSpace(np.array([[0, 1.0], [-48.0, -2.1]]), np.array([[0.0], [41.0]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
SD = {"A": np.array([[0, 0], [4.8, 0.21]]), "B": np.array([[0.0], [4.1]])}
MODEL = Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q")), PLANT, entry_sd=SD)
LIBRARY = [p for p in afdsvc_physics() if p.name in ("cubic_stiffness", "transport_delay", "sensor_lag", "actuator_lag")]


def recording(seed: int) -> Trace:
    """Return a hardening spring under coloured noise that is held over every sample, integrated by the Runge-Kutta method."""
    rng, n = np.random.default_rng(seed), 2000
    u, x, y = np.zeros(n), np.zeros(2), np.zeros(n)
    for k in range(1, n):
        u[k] = 0.95 * u[k - 1] + 3 * np.sqrt(1 - 0.95**2) * rng.normal()

    def rate(x, u):
        return np.array([x[1], -50 * x[0] - 2 * x[1] - 30 * x[0] ** 3 + 40 * u])

    h = DT / 4
    for k in range(n):
        y[k] = x[0]
        for _ in range(4):
            a = rate(x, u[k])
            b = rate(x + h / 2 * a, u[k])
            c = rate(x + h / 2 * b, u[k])
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u[k]))
    return Trace(f"r{seed}", DT, (Channel("u_force", "N"), Channel("y_position", "mm")), np.column_stack([u, y + 0.01 * rng.standard_normal(n)]))


def test_whether_inputs_are_held_is_decided_anew_beside_an_effect():
    *given, held = map(recording, (88, 89, 90))
    (found,) = explain(MODEL, given, [held], LIBRARY, experiment=False).named
    assert found.physics == "cubic_stiffness"
