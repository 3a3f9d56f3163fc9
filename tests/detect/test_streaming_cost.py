"""The cost of a sample depends neither on the length of the burst nor on the number of hypotheses."""

from itertools import takewhile
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import played, simulate_burst
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem
from benchmarks.support.streaming import many_faults, work

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
    blocks = simulate_burst(problem, alpha, v).blocks(SIZE, burst, QUIET)
    return list(takewhile(lambda b: b.k0 + len(b) < len(alpha), blocks))


def steady(record):
    """Calls and memory of the dearest of the last blocks."""
    return max(w.calls for w in record[-4:]), max(w.memory for w in record[-4:])


@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "chi_square", "regression", "cusum"])
def test_fifty_hypotheses_are_no_loop_over_fifty(name, problem):
    blocks = streamed(problem, 1.0)
    few, many = (steady(work(DESIGNS[name].design(many_faults(problem, count), {}), blocks)) for count in (4, 50))
    assert many[0] == few[0]
    assert many[1] < 2 * few[1]


@pytest.mark.parametrize("name", ["matched_filter", "fault_curves", "regression", "cusum"])
def test_a_block_of_a_long_burst_costs_no_more_than_one_of_a_short_burst(name, problem):
    detector = DESIGNS[name].design(problem, {})
    short, long = (steady(work(detector, streamed(problem, seconds))) for seconds in (0.8, 6.0))
    assert long[0] <= short[0]
    assert long[1] < 1.2 * short[1]


def test_work_counts_what_grows():
    """A detector that looks at everything again with every block is caught."""
    blocks = [SimpleNamespace(r=np.ones((SIZE, 2))) for _ in range(9)]
    hoarder = SimpleNamespace(start=list, step=lambda seen, b: ([*seen, b.r], [np.vstack([*seen, b.r]).sum() for _ in seen]))
    found = work(hoarder, blocks)
    assert [w.calls for w in found] == sorted(w.calls for w in found)
    assert found[-1].calls > 2 * found[2].calls
    assert found[-1].memory > 2 * found[2].memory
