"""A magnet recorded in absolute currents and gaps, with a model about its operating point."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, BIAS, GAP, WEIGHT = 0.002, 0.8, 0.006, 9.81  # s, A, m, m/s^2
PLANT = StateSpace(np.array([[0, 1.0], [2 * WEIGHT / GAP, 0]]), np.array([[0.0], [-2 * WEIGHT / BIAS]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
SD = {name: 0.1 * np.abs(matrix) * (np.abs(matrix) != 1) for name, matrix in (("A", PLANT.A), ("B", PLANT.B))}
MODEL = Model("magnet", (Variable("current", "A"),), (Variable("gap", "m"),), (Variable("gap", "m"), Variable("v", "m/s", rate_of="gap")), PLANT, entry_sd=SD)
LIBRARY = [p for p in afdsvc_physics() if p.name in ("magnetic_force", "gain_follows_position", "sensor_rectification", "back_emf", "cubic_stiffness")]


def recording(seed: int) -> Trace:
    """Return a body that hangs below a magnet under a controller nobody knows, following a reference that wanders."""
    rng, n = np.random.default_rng(seed), 3000
    reference, x, u, y = np.zeros(n), np.array([GAP, 0.0]), np.zeros(n), np.zeros(n)
    for k in range(1, n):
        reference[k] = 0.98 * reference[k - 1] + 0.0006 * np.sqrt(1 - 0.98**2) * rng.normal()
    for k in range(n):
        y[k] = x[0] + 1e-6 * rng.normal()
        u[k] = np.clip(BIAS + 540 * (y[k] - GAP - reference[k]) + 12 * x[1], 0, 3)
        for _ in range(10):
            x = x + DT / 10 * np.array([x[1], WEIGHT * (1 - (u[k] / BIAS) ** 2 * (GAP / x[0]) ** 2)])
    return Trace(f"r{seed}", DT, (Channel("u_current", "A"), Channel("y_gap", "m")), np.column_stack([u, y]))


def test_a_magnetic_force_is_found_in_absolute_signals():
    *given, held = map(recording, (40, 41, 42))
    found = explain(MODEL, given, [held], LIBRARY, experiment=False).named
    assert (found[0].physics, found[0].weight > 0.8) == ("magnetic_force", True)
    assert found[0].parameters["bias"].value == pytest.approx(BIAS, rel=0.05)
    assert found[0].parameters["gap"].value == pytest.approx(GAP, rel=0.05)
    assert "sensor_rectification" not in {n.physics for n in found}
