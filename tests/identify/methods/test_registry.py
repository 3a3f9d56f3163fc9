"""Starts of a refinement that the registry hands over."""

import numpy as np

from afdsvc.identify.methods.registry import _answering_at_once
from afdsvc.lti.statespace import StateSpace


def test_a_start_without_feedthrough_takes_over_the_nominal_one():
    one = np.eye(1)
    nominal = StateSpace(0.9 * one, one, one, 0.3 * one, 1.0)
    found = _answering_at_once(StateSpace(0.8 * one, one, one, 0 * one, 1.0), nominal)
    assert (found.A[0, 0], found.D[0, 0]) == (0.8, 0.3)
    assert _answering_at_once(StateSpace(0.8 * one, one, one, 0.1 * one, 1.0), nominal).D[0, 0] == 0.1
