"""Two effects at one port act one after the other, and the order is found out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.explain.explain import explain
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.physics import afdsvc_physics

DT, PERIOD, PERIODS, NOISE, HUM, LIMIT = 1e-3, 1000, 4, 0.02, 0.5, 2.5
LIBRARY = [p for p in afdsvc_physics() if p.name in ("periodic_disturbance", "sensor_saturation", "sensor_nonlinearity", "sensor_offset", "saturation")]


def spring() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-4e4, -30.0]]), np.array([[0.0], [4e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant, output_sd=np.array([NOISE]))


def recordings(cut_last: bool) -> list[Trace]:
    """Return recordings whose sensor has a hum and a limit, the limit behind the hum or before it."""
    found = []
    for seed, level in enumerate((1.0, 0.6, 0.8)):
        rng = np.random.default_rng(seed)
        lines = np.arange(1, 60, 2)
        t = np.arange(PERIOD * PERIODS) * DT
        u = np.cos(2 * np.pi * np.outer(t, lines) / (PERIOD * DT) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
        u *= level / u.std()
        y = simulate(sample_zoh(spring().plant, DT), u[:, None])[0][:, 0]
        hum = HUM * np.sin(2 * np.pi * 37.3 * t + seed)
        read = np.clip(y + hum, -LIMIT, LIMIT) if cut_last else np.clip(y, -LIMIT, LIMIT) + hum
        values = np.column_stack([u, read + NOISE * rng.standard_normal(len(u))])
        found.append(Trace(f"r{seed}", DT, (Channel("u_force"), Channel("y_position")), values))
    return found


@pytest.mark.parametrize("cut_last", [True, False])
def test_what_hums_before_a_limit_and_what_hums_behind_it(cut_last):
    *given, held = recordings(cut_last)
    answer = explain(replace(spring(), entry_sd={name: np.zeros_like(getattr(spring().plant, name)) for name in "ABC"}), given, [held], LIBRARY, rehearse=False)
    told = {(n.physics, n.site) for n in answer.named}
    assert {("periodic_disturbance", "output:position"), ("sensor_saturation", "output:position")} <= told
    assert [e.hypothesis.physics for e in answer.point.effects][0 if cut_last else 1] == "periodic_disturbance"
    assert len(answer.point.effects) == 2
    assert answer.fit[0].after_nrmse < 1.1 * answer.fit[0].noise_floor_nrmse
