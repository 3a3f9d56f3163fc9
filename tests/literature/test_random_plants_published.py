"""Publication P2, section 4: random stable plants with 2 inputs, 2 outputs, 4 states and ``A_model = 0.7 A_real``.

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, DTU 2017. The paper
gives order 12 for the true S; it is 8, the order of the plant plus that of J_K.
"""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.reduce import balanced_truncation, hankel_singular_values
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.stability import is_stable
from afdsvc.lti.yjbk import deviation_system
from afdsvc.plants.examples import random_stable


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_true_deviation_is_stable_and_of_order_eight(dt: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        true, nominal = random_stable(rng, dt=dt)
        F, L = lqr(nominal, np.eye(4), np.eye(2)), kalman_predictor_gain(nominal, np.eye(4), np.eye(2))
        S = deviation_system(observer_factorisation(nominal, F, L), true)
        assert S.order == 8
        if not is_stable(S.A, dt):  # the controller need not stabilise every true plant
            continue
        values = hankel_singular_values(S)
        assert values[7] > 1e-9 * values[0]  # eight states matter: the order is minimal
        assert balanced_truncation(S, tolerance=1e-12).system.order == 8
