"""A second effect beside a first, however short the moment in which it shows."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE = 1e-3, 500, 4, 0.05
PLANT = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
STATES = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
SD = {name: 0.02 * np.abs(matrix) * (np.abs(matrix) != 1) for name, matrix in (("A", PLANT.A), ("B", PLANT.B), ("C", PLANT.C))}
MODEL = Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), STATES, PLANT, entry_sd=SD, output_sd=np.array([NOISE]))


def recording(seed: int) -> Trace:
    """A curved actuator, and a sensor whose gain follows a temperature that moves for 60 ms only."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 60, 2)
    u = np.cos(2 * np.pi * np.outer(np.arange(PERIOD) / PERIOD, lines) + rng.uniform(0, 7, len(lines))).sum(1)
    u = (0.6, 0.8, 1.0, 0.9, 0.7)[seed] * np.tile(u, PERIODS)
    t = np.arange(len(u))
    temperature = 30 + 4 * np.exp(-(((t - 900 - 130 * seed) / 30.0) ** 2)) + 0.01 * rng.standard_normal(len(u))
    y = simulate(sample_zoh(PLANT, DT), (u - 0.002 * u**3)[:, None])[0][:, 0]
    y = y * (1 + 0.03 * (temperature - 30)) + NOISE * rng.standard_normal(len(u))
    return Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position"), Channel("aux_temperature")), np.column_stack([u, y, temperature]))


def test_what_follows_a_signal_that_moves_for_a_moment_is_named_beside_another():
    *given, held = map(recording, range(5))
    answer = explain(MODEL, given, [held], afdsvc_physics(), experiment=False)
    assert {n.physics for n in answer.named if n.weight > 0.3} >= {"static_nonlinearity", "gain_follows_aux"}, answer.sentences
    assert all("% of what the other effects leave" in n.sentence for n in answer.named)
    assert answer.fit[0].after_nrmse == pytest.approx(answer.fit[0].noise_floor_nrmse, rel=0.1)
