"""A burst that ends early, because a limit is met or a lease is lost: every detector says so and goes on, whatever is broken."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem
from benchmarks.support.trials import trials

PROBLEM = bearing_problem()
BURST = default_burst(PROBLEM, Limits(np.full(2, 10.0), np.full(2, 10.0), np.full(2, 100.0)), 2.0)
DESIGNS = {d.name: d for d in afdsvc_detectors() if d.name != "passive_cusum"}


@pytest.fixture(scope="module", params=["vertical_sensor", "horizontal_actuator"])
def run(request):
    """The record of a burst with a loss of 50 %, after quiet samples."""
    trial = trials(PROBLEM, BURST, {request.param: -0.5}, before=4000)
    return trial.whole(trial.noise(1))[2]


@pytest.mark.parametrize("name", DESIGNS)
@pytest.mark.parametrize("after", [50, 500, 1000, 9950])
def test_a_burst_that_ends_early_is_said_to_and_disables_no_detector(run, name, after):
    """The regression failed over a fault in a burst that ended before its first part was over, and was disabled until the service was started again."""
    detector, found = DESIGNS[name].design(PROBLEM, {}), []
    state = detector.start()
    for block in run.blocks(50, BURST, 4000):
        if block.k0 >= 4000 + after:
            block = replace(block, burst=None, burst_name="")
        state, evidence = detector.step(state, block)
        found += evidence
    assert found
    for e in found:  # of the CUSUM one that was made before the end
        assert (e.trustworthy and name == "cusum") or f"ended after {after} of 10000 samples" in e.reason
