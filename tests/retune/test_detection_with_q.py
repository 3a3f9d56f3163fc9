"""With Q in place detectors made for the loop with Q keep their rate and estimate severities without bias; made for the old loop they do not.

Monte Carlo with fixed seeds on machines simulated by `benchmarks.retune.detection`, which shares no code with the detectors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from afdsvc.plugins.detectors.burst_detectors import FaultCurvesDesign, MatchedFilterDesign, RegressionDesign
from afdsvc.retune.design import retuned_problem
from afdsvc.testing.machines import bearing_problem
from benchmarks.retune.detection import FIRST, OTHER, RATE, SECOND, TRUTH, judged, loop

RUNS = 80


pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def loops():
    """Return the problem of the running loop, that of the loop with Q, and Q."""
    problem, Q = loop("proportional")
    return problem, retuned_problem(problem, Q), Q


@pytest.mark.parametrize("design", [MatchedFilterDesign(), RegressionDesign()], ids=["matched_filter", "regression"])
def test_the_promised_rate_of_false_alarms_holds_with_q(loops, design):
    problem, with_q, Q = loops
    alarms = sum(e.detected for e in judged(with_q, design, problem, Q, (0.0, 0.0), RUNS))
    assert binom.cdf(alarms, RUNS, RATE) > 1e-3  # 99.8 % confidence
    assert binom.sf(alarms - 1, RUNS, RATE) > 1e-3


def test_the_severity_is_unbiased_for_the_loop_with_q_and_biased_without(loops):
    problem, with_q, Q = loops
    z = {}
    for name, known in (("with Q", with_q), ("without", problem)):
        found = [e.severity for e in judged(known, FaultCurvesDesign(), problem, Q, (TRUTH, 0.0), RUNS) if e.severity]
        assert len(found) > RUNS / 2
        error = np.array([s.value - TRUTH for s in found])
        z[name] = error.mean() / (error.std() / np.sqrt(len(found)))
    assert abs(z["with Q"]) < 4
    assert abs(z["without"]) > 6


def test_a_second_fault_is_named_beside_the_one_q_was_designed_for(loops):
    whole, (problem, _, Q) = bearing_problem("proportional"), loops
    both = retuned_problem(replace(problem, augmented=whole.augmented.reordered([FIRST, OTHER])), Q)
    for second, name in ((0.0, FIRST), (SECOND, f"{FIRST}+{OTHER}")):
        found = judged(both, RegressionDesign(), problem, Q, (TRUTH, second), RUNS)
        assert sum(e.fault == name for e in found) >= 0.95 * RUNS
