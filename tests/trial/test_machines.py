"""The made-up rotor: unstable alone, held by its controller, and what is left out of it is found at speed."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.explain.pipeline import explain
from afdsvc.files.model.model_file import parse_model
from afdsvc.plugins.manager import load
from afdsvc.trial.folder import nominal_model_text
from afdsvc.trial.generate import BlindTrial, generate_trial
from afdsvc.trial.machine import sampled_plant
from afdsvc.trial.machines import RotorOptions, rotor


def test_it_falls_without_its_controller_and_is_held_by_it() -> None:
    m = rotor()
    A, B, C = m.matrices(m.nominal)
    assert not m.stable
    assert np.linalg.eigvals(A).real.max() == pytest.approx(336.5, abs=0.5)  # rad/s: sqrt(2 * 1.2 MN/m / 21.2 kg)
    Ad, Bd = sampled_plant(A, B, m.dt)
    K = m.controller
    loop = np.block([[Ad + Bd @ K.D @ C, Bd @ K.C], [K.B @ C, K.A]])
    assert np.abs(np.linalg.eigvals(loop)).max() < 0.995


def trial(physics: str, rho: float = 0.3) -> BlindTrial:
    return generate_trial(physics, None, rho, np.random.default_rng(5), RotorOptions())


def test_trials_stay_inside_the_machines_limits_and_turn() -> None:
    made = trial("unbalance")
    for record in (*made.recordings, made.holdout):
        assert np.abs(record.role("y")).max() < 125.0
        assert 2700 < record.column("aux_speed").mean() < 3320
    assert made.answer.hidden[0].rho == pytest.approx(0.3, abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("physics", ["unbalance", "gyroscopic_coupling", "cross_coupled_stiffness", "runout"])
def test_rotor_physics_is_found_blind_at_speed(physics: str) -> None:
    made = trial(physics)
    model = parse_model(nominal_model_text(made.machine), "MODEL.toml")
    found = explain(model, made.recordings, [made.holdout], [o.thing for o in load().family("physics")])
    assert found.verdict == "omitted_physics"
    assert found.named[0].physics == physics
    assert found.named[0].weight > 0.9
