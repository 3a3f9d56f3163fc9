"""Physics under slow noise: seen only where residuals are divided by their own spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, SAMPLES = 0.01, 3000
PLANT = StateSpace(np.array([[-8.0]]), np.array([[8.0]]), np.eye(1), np.zeros((1, 1)))
MODEL = Model("oven", (Variable("power", "W"),), (Variable("temperature", "K"),), (Variable("x", "K"),), PLANT)


def recording(seed: int, dead: float) -> Trace:
    """Return a first-order lag behind a dead zone, driven by random steps; the reading wanders."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, SAMPLES // 20), 20)
    w = np.sign(u) * np.maximum(np.abs(u) - dead, 0.0)
    y = lfilter([0.0, 1 - np.exp(-8 * DT)], [1.0, -np.exp(-8 * DT)], w)
    wander = lfilter([1.0], [1.0, -0.999], rng.standard_normal(SAMPLES))
    return Trace(f"r{seed}", DT, (Channel("u_power"), Channel("y_temperature")), np.column_stack([u, y + 0.2 * (wander - wander.mean()) / wander.std()]))


@pytest.mark.parametrize(("dead", "names"), [(0.2, {"dead_zone"}), (0.0, set())])
def test_a_dead_zone_is_named_below_noise_that_is_slow(dead, names):
    answer = explain(MODEL, [recording(k, dead) for k in (1, 2)], [recording(3, dead)], afdsvc_physics(), experiment=False)
    assert {n.physics for n in answer.named if n.weight > 0.5} == names
