"""Slopes of sampling, Riccati equation and predictor equal difference quotients of the whole chain."""

import numpy as np
import pytest

from afdsvc.errors import IllConditioned
from afdsvc.identify.parameters.noise_structure import plant_point, predictor_point
from afdsvc.identify.parameters.structure import FreeParameter, Structure, physical_structure
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations
from afdsvc.plants.gas_bearing import gas_bearing

PLANT = gas_bearing(0)
FREE = [name for name in PLANT.parameters if name != "mass"]
RATES = ("horizontal_rate", "vertical_rate")
NOISE = np.log([0.35, 0.4, 200.0, 150.0])


def _relative(found, wanted):
    return np.abs(found - wanted).max() / np.abs(wanted).max()


def test_every_slope_of_the_predictor_equals_its_difference_quotient():
    structure, dt = physical_structure(PLANT, FREE, RATES), PLANT.sample_time
    theta = structure.values * 1.02
    at = predictor_point(structure, theta, NOISE, dt)
    point, steps = np.concatenate([theta, NOISE]), np.concatenate([1e-4 * structure.scales, np.full(4, 1e-5)])
    for i, h in enumerate(np.diag(steps)):
        ahead, behind = (predictor_point(structure, *np.split(point + s * h, [14]), dt) for s in (1, -1))
        for k in "AB":
            quotient = (getattr(ahead.predictor, k) - getattr(behind.predictor, k)) / (2 * steps[i])
            assert _relative(getattr(at.slopes, k)[i], quotient) < 1e-5, (i, k)
        quotient = (ahead.covariance - behind.covariance) / (2 * steps[i])
        assert np.abs(at.covariance_slopes[i] - quotient).max() < 1e-5 * max(np.abs(quotient).max(), 1e-6 / steps[i])


def test_predictor_is_the_kalman_filter_of_the_plant():
    structure = physical_structure(PLANT, FREE, RATES)
    at = predictor_point(structure, structure.values, NOISE, PLANT.sample_time)
    variances = np.exp(2 * NOISE)
    wanted = innovations(PLANT.discrete(), np.diag(variances[:2]), np.diag([0, 0, *variances[2:], 0, 0]))
    assert _relative(at.gain, wanted.gain) < 1e-9
    assert _relative(at.covariance, wanted.covariance) < 1e-9


def test_output_noise_alone_needs_no_gain_for_a_stable_plant_and_mirrors_an_unstable_one():
    structure = physical_structure(PLANT, FREE)
    assert not predictor_point(structure, structure.values, NOISE[:2], PLANT.sample_time).gain.any()
    unstable = Structure((FreeParameter("a", 1.25),), lambda th: StateSpace.of([[th[0]]], [[1.0]], [[1.0]], [[0.0]], 1.0))
    at = predictor_point(unstable, np.array([1.25]), np.zeros(1), 1.0)
    assert at.predictor.A[0, 0] == pytest.approx(1 / 1.25)
    assert at.covariance[0, 0] == pytest.approx(1.25**2)  # d/da of it is 2 a
    assert at.covariance_slopes[0, 0, 0] == pytest.approx(2.5, rel=1e-6)


def test_sampled_plant_is_the_plants_own():
    structure = physical_structure(PLANT, FREE)
    plant, _ = plant_point(structure, structure.values, PLANT.sample_time)
    wanted = PLANT.discrete()
    assert _relative(plant.A, wanted.A) < 1e-12
    assert _relative(plant.B, wanted.B) < 1e-12


def test_absurd_rates_are_refused():
    fast = Structure((FreeParameter("a", -1e9),), lambda th: StateSpace.of([[th[0]]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(IllConditioned, match=r"pole of size 1e\+06 per sample"):
        plant_point(fast, np.array([-1e9]), 1e-3)
