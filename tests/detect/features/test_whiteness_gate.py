"""Quiet data that a fault changes are trusted with the fault taken out, on a machine whose process noise the sensors show less of."""

import numpy as np
import pytest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged, quiet, shown
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import alpha_of, problem_of

MACHINE = next(m for m in machines() if m.name == "process noise large")
PROBLEM = problem_of(MACHINE, FalseAlarms(1e-2))
BURST = Burst("b", 2, 2000, 100, (Line(0, 220.0, 6.0), Line(1, 610.0, 6.0)), settle=60)
DETECTOR = load().get("detectors", "regression").design(PROBLEM, {})


@pytest.mark.parametrize("loss", [{"s0": -0.2}, {"s1": -0.3}, {"a0": -0.2, "s0": -0.2}, {"s0": -0.2, "s1": -0.2}])
def test_weak_sensors_and_pairs_are_judged(loss):
    found = [judged(MACHINE, PROBLEM, DETECTOR, BURST, seed, loss) for seed in range(10)]
    assert sum(e.p_white > 1e-3 for e in found) >= 9
    assert sum(e.detected for e in found) >= 9


def test_noise_that_no_fault_makes_is_refused():
    alpha = alpha_of(BURST, MACHINE.dt, quiet(PROBLEM))
    found = [shown(PROBLEM, [DETECTOR], MACHINE.run(np.random.default_rng(seed), alpha, noisier=1.1), BURST)[0][-1] for seed in range(10)]
    assert sum(not e.trustworthy and "times the stated standard deviation" in e.reason for e in found) >= 9
