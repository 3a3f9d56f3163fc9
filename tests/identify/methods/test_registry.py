"""Bands and starts that the registry hands over."""

import numpy as np
import pytest

from afdsvc.identify.methods.registry import _answering_at_once, band_hz
from afdsvc.lti.statespace import StateSpace


def test_a_start_without_feedthrough_takes_over_the_nominal_one():
    one = np.eye(1)
    nominal = StateSpace(0.9 * one, one, one, 0.3 * one, 1.0)
    found = _answering_at_once(StateSpace(0.8 * one, one, one, 0 * one, 1.0), nominal)
    assert (found.A[0, 0], found.D[0, 0]) == (0.8, 0.3)
    assert _answering_at_once(StateSpace(0.8 * one, one, one, 0.1 * one, 1.0), nominal).D[0, 0] == 0.1


def test_integrators_act_in_every_band():
    one = np.eye(1)
    assert band_hz(StateSpace(one, one, one, 0 * one, 0.1)) == pytest.approx((0.01, 4.0))
    both = StateSpace(np.diag([1.0, np.exp(-0.2)]), np.ones((2, 1)), np.ones((1, 2)), 0 * one, 0.1)
    assert band_hz(both) == pytest.approx((0.2 / np.pi / 2, 4 / np.pi / 2 * 0.1 * 10))
