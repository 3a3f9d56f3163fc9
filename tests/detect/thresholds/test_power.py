"""Detection and isolation probabilities against published figures and simulation."""

import numpy as np
import pytest

from afdsvc.detect.thresholds import power
from afdsvc.errors import BadInput


def test_published_deflection_for_99_percent_at_one_in_a_million():
    # Q^-1(1e-6) - Q^-1(0.99) from normal tables: 4.7534 + 2.3263
    assert power.required_deflection(1e-6, 0.99) == pytest.approx(7.07977, abs=1e-4)


@pytest.mark.parametrize(("energy", "printed"), [(2.70, 0.801), (3.02, 0.871)])
def test_probability_printed_in_p3(energy, printed):
    # thesis, publication P3: variance 0.11, P_FA 2e-5; "80 %" is printed for an energy of 2.70
    assert power.detection_probability(2e-5, np.sqrt(energy / 0.11)) == pytest.approx(printed, abs=2e-3)


def test_detection_probability_matches_simulation():
    z = np.random.default_rng(1).normal(size=400_000)
    found = np.mean(z + 3.0 > power.tail_point(1e-2))
    assert power.detection_probability(1e-2, 3.0) == pytest.approx(found, abs=4 * 0.5 / 630)


def test_a_published_power_of_a_known_wave():
    assert power.detection_probability(1e-4, 5.0) == pytest.approx(0.8999, abs=1e-4)


def test_weights_of_two_hypotheses_match_simulation():
    rng, s, n = np.random.default_rng(2), 3.0, 400_000
    ratio = rng.normal(s**2 / 2, s, n)
    bound = np.log(0.99 / 0.01)
    assert power.weight_reached(s, 0.99) == pytest.approx(np.mean(ratio > bound), abs=0.003)


def test_required_separation_inverts_weight_reached():
    s = power.required_separation(0.99, 0.999)
    assert power.weight_reached(s, 0.99) == pytest.approx(0.999, abs=1e-9)


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, float("nan")])
def test_impossible_probabilities_are_named(probability):
    with pytest.raises(BadInput, match="between 0 and 1"):
        power.detection_probability(probability, 1.0)
