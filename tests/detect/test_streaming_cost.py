"""The cost of a sample depends neither on the length of the burst nor on the number of hypotheses."""

import time
from itertools import takewhile

import numpy as np
import pytest

from afdsvc.excite.default import default_burst
from afdsvc.excite.rehearsal import played, rehearse
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem
from afdsvc.testing.streaming import cost_per_sample, many_faults

DESIGNS = {d.name: d for d in afdsvc_detectors()}
QUIET, SIZE = 3000, 500


@pytest.fixture(scope="module")
def problem():
    return bearing_problem("lqg")


def streamed(problem, seconds):
    """Blocks of quiet data and of a burst, up to the one it ends in."""
    burst = default_burst(problem, problem.limits, seconds, 1.0)
    alpha = played(burst, problem.plant.dt, QUIET)
    v = np.random.default_rng(1).normal(size=alpha.shape) @ np.linalg.cholesky(problem.covariance).T
    blocks = rehearse(problem, alpha, v).blocks(SIZE, burst, QUIET)
    return list(takewhile(lambda b: b.k0 + len(b) < len(alpha), blocks))


@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "chi_square", "regression", "cusum"])
def test_fifty_hypotheses_cost_as_much_as_four(name, problem):
    blocks = streamed(problem, 1.0)
    few, many = (
        cost_per_sample(DESIGNS[name].design(many_faults(problem, count), {}), blocks, time.process_time) for count in (4, 50)
    )
    assert many < 1.5 * few


@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "regression", "cusum"])
def test_a_long_burst_costs_no_more_per_sample_than_a_short_one(name, problem):
    detector = DESIGNS[name].design(problem, {})
    short, long = (cost_per_sample(detector, streamed(problem, s), time.process_time, 8) for s in (0.8, 6.0))
    assert long < 1.5 * short
