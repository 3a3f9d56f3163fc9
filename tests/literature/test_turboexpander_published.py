"""Publication P1 (A. K. Sekunda, PhD thesis, DTU 2017): bearing stiffness of the turboexpander through S(theta)."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.indirect import fit_indirect
from afdsvc.identify.parameters.structure import physical_structure
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.stability import is_stable
from afdsvc.lti.yjbk import deviation_system
from afdsvc.plants.amb_turboexpander import amb_turboexpander, turboexpander_rotor
from afdsvc.plugins.controllers.lqg import Lqg

STIFFNESS, SAMPLE_TIME, SAMPLES = "stiffness_b_y", 1e-3, 500  # P1 section 4: 0.5 s at 1 ms


@pytest.mark.parametrize("full", [False, True])
def test_half_the_stiffness_is_found_as_in_the_paper(full: bool) -> None:
    """P1 finds 0.502 for 0.5; asked for here: within 0.005, on the small model and on all 320 states.

    A random binary signal on alpha, no noise. The plant and its faulty form are unstable, S(theta) is not (figs. 0.6, 0.7).
    """
    plant = amb_turboexpander(sample_time=SAMPLE_TIME)
    nominal = plant.parameters[STIFFNESS].value
    G, changed = plant.discrete(), {STIFFNESS: 0.5 * nominal}
    true = plant.discrete(**changed)
    if full:
        true = sample_zoh(turboexpander_rotor(31500.0).full_system(plant.values(changed)), SAMPLE_TIME)
    fact = Lqg().design(G, plant.recommended["lqg"]).factorisation
    S = deviation_system(fact, true)
    assert not true.is_stable()
    assert is_stable(S.A, S.dt)
    alpha = 0.02 * np.random.default_rng(1).choice([-1.0, 1.0], size=(SAMPLES, 4))
    beta, _ = simulate(S, alpha)
    fit = fit_indirect(physical_structure(plant, [STIFFNESS]), fact, [InputOutputData.of(alpha, beta, SAMPLE_TIME)])
    theta = fit.parameters[0].value / nominal - 1
    assert theta == pytest.approx(-0.5, abs=0.002 if full else 1e-4)  # without noise: where the descent stops


def test_the_column_of_the_bearing_and_not_of_the_shaft() -> None:
    """P1 (48)-(49) prints the whole column of A, which holds the shaft's stiffness too; that misses by far more."""
    plant, rotor = amb_turboexpander(), turboexpander_rotor(31500.0)
    w = np.geomspace(30.0, 5000.0, 15)
    changed = plant.values({STIFFNESS: 0.5 * plant.parameters[STIFFNESS].value})
    wanted = frequency_response(rotor.reduced(changed, 8), w)
    ours = frequency_response(plant.continuous(**{STIFFNESS: changed[STIFFNESS]}), w)
    assert np.abs(ours - wanted).max() < 1e-3 * np.abs(wanted).max()
    # as printed: theta times all the stiffness in the row and column of the node, shaft included
    direction = rotor.rotor.direction(rotor.bearings[1].node, 1)
    column = rotor.rotor.K @ direction + direction * plant.parameters[STIFFNESS].value
    assert np.abs(column).max() > 1e2 * abs(plant.parameters[STIFFNESS].value)
