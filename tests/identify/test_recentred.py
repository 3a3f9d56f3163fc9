"""Parameters far from nominal: renewed coprime factors make the standard errors right, and small."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.identify.recentred import fit_recentred
from afdsvc.identify.recordings import Recording
from afdsvc.identify.structure import physical_structure
from afdsvc.lti.simulate import simulate
from afdsvc.lti.yjbk import closed_loop
from afdsvc.plants.amb_turboexpander import NOISE_SD, amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg

CHANGE = {"stiffness_a_x": -0.3, "stiffness_b_y": -0.5}


def recording(samples: int, seed: int = 3) -> tuple[Recording, dict[str, float], object, object]:
    """Return u and y of the loop from rest, the true values, the plant and its controller."""
    plant = amb_turboexpander()
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    values = {name: plant.parameters[name].value * (1 + theta) for name, theta in CHANGE.items()}
    rng = np.random.default_rng(seed)
    alpha = 0.05 * np.repeat(rng.choice([-1.0, 1.0], size=(samples // 10, 4)), 10, axis=0)
    noise = NOISE_SD * rng.standard_normal((samples, 4))
    out, _ = simulate(closed_loop(fact, plant.discrete(**values)).system, np.hstack([noise, np.zeros((samples, 8)), alpha]))
    return Recording.of(out[:, 8:12], out[:, 4:8], plant.sample_time), values, plant, fact.K


def test_two_stiffnesses_within_their_standard_errors_which_shrink() -> None:
    """0.7 s of data; one round alone takes the noise for white where it is not and knows five times less."""
    data, values, plant, K = recording(7000)
    structure = physical_structure(plant, list(CHANGE))
    once, found = (fit_recentred(structure, K, [data], plant.output_cov, rounds) for rounds in (1, 2))
    for name, before, after in zip(CHANGE, once.parameters, found.parameters, strict=True):
        assert abs(after.value - values[name]) < 3.5 * after.sd, name
        assert after.sd < 0.4 * before.sd
        assert after.sd < 0.004 * abs(plant.parameters[name].value)


def test_too_short_for_the_whitening_filter() -> None:
    data, _, plant, K = recording(600)
    with pytest.raises(BadInput, match=r"the whitening filter does not settle within \d+ samples; a longer recording is wanted"):
        fit_recentred(physical_structure(plant, list(CHANGE)), K, [data], plant.output_cov, 2)
