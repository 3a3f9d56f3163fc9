"""Recordings that are cut out of a longer run: what a mode does as they begin is fitted, as the initial state is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.pipeline import explain
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import BUILT_IN

DT, KNOWN, OMITTED = 0.01, (8.0, 0.02), (31.0, 0.004)
SOME = ("flexible_mode", "creep", "actuator_lag")


def resonance(u: np.ndarray, w: float, zeta: float) -> np.ndarray:
    """The answer of ``q'' + 2 zeta w q' + w^2 q = w^2 u`` to an input held between samples."""
    decay, turn = np.exp(-zeta * w * DT), w * np.sqrt(1 - zeta**2) * DT
    a1, a2 = -2 * decay * np.cos(turn), decay**2
    s = zeta / np.sqrt(1 - zeta**2)
    b1, b2 = 1 - decay * (np.cos(turn) + s * np.sin(turn)), decay**2 + decay * (s * np.sin(turn) - np.cos(turn))
    return lfilter([0.0, b1, b2], [1.0, a1, a2], u)


def test_a_mode_that_rings_as_a_recording_begins_follows_it():
    rng = np.random.default_rng(5)
    pieces = []
    for k in range(3):
        u = rng.standard_normal(1000)
        y = resonance(u, *KNOWN) + 0.3 * resonance(u, *OMITTED) + 0.01 * rng.standard_normal(1000)
        pieces.append(Trace(f"r{k}", DT, (Channel("u_force", "N"), Channel("y_place", "m")), np.column_stack([u, y])[500:900]))
    w, zeta = KNOWN[0] * 1.01, 0.022
    plant = StateSpace.of([[0, 1], [-(w**2), -2 * zeta * w]], [[0], [w**2]], [[1, 0]])
    model = Model("structure", (Variable("force", "N"),), (Variable("place", "m"),), (Variable("q", "m"), Variable("v", "m/s", rate_of="q")), plant)
    found = explain(model, pieces[:2], pieces[2:], [p() for p in BUILT_IN if p.name in SOME], experiment=False)
    assert found.named[0].physics == "flexible_mode"
    assert found.named[0].parameters["frequency"].value == pytest.approx(OMITTED[0], rel=0.01)
    assert found.fit[0].before_nrmse > 0.05
    assert found.fit[0].after_nrmse < 0.03
