"""Refits that begin with borrowed columns end where refits of their own do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.baseline import Baseline, baseline
from afdsvc.explain.forward import seen
from afdsvc.explain.nominal import nominal
from afdsvc.explain.objective import Point, _factor, borrowed, tangent
from afdsvc.explain.settle import full_cost, settle
from afdsvc.explain.simulator import Effect
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE = 1e-3, 500, 4, 0.3
PLANT = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))


@pytest.fixture(scope="module")
def base() -> Baseline:
    """A spring whose reading is bent."""
    model = Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q")), PLANT)
    traces = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        t = np.arange(PERIOD) * DT
        u = np.cos(2 * np.pi * np.outer(t, np.arange(1, 50, 2)) / (PERIOD * DT) + rng.uniform(0, 7, 25)).sum(1)
        u = np.tile(u / u.std() / (seed + 1), PERIODS)
        y = simulate(sample_zoh(PLANT, DT), u[:, None])[0][:, 0]
        values = np.column_stack([u, y + 0.02 * y**3 + NOISE * rng.standard_normal(len(u))])
        traces.append(Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), values))
    runs = prepare(model, traces)
    return baseline(nominal(model, runs[0].dt), runs)


@pytest.mark.parametrize("key", ["cubic_stiffness@state:v", "sensor_nonlinearity@output:position", "coulomb_friction@state:v"])
def test_borrowed_columns_lead_to_the_same_place(base, key):
    hypothesis = next(h for p in afdsvc_physics() for h in p.hypotheses(seen(base)) if h.key == key)
    start: Point = base.point.with_effect(Effect(hypothesis, np.array(hypothesis.starts[0], float)))
    own = settle(base.objective, start, 20)
    lent = settle(base.objective, start, 20, known=borrowed(tangent(base.objective, base.point)))
    assert full_cost(base.objective, lent) == pytest.approx(full_cost(base.objective, own), abs=0.5)


def test_wrong_columns_are_given_up(base):
    lent = borrowed(tangent(base.objective, base.point))
    off = replace(base.point, theta=base.point.theta + 1.0)
    there = settle(base.objective, off, 20, known=replace(lent, J=lent.J[::-1].copy()))
    assert full_cost(base.objective, there) == pytest.approx(full_cost(base.objective, base.point), abs=0.5)


def test_a_normal_matrix_that_rounding_made_singular_is_factored_all_the_same():
    """Where a simulation left, columns are huge and alike; 1e-3 of prior is lost in them."""
    J = 1e15 * np.column_stack([np.ones(50), np.ones(50) * (1 + 1e-16), np.linspace(1, 2, 50)])
    H = J.T @ J + 1e-6 * np.eye(3)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(H)
    r = _factor(H)
    assert r.T @ r == pytest.approx(H, rel=1e-6)
