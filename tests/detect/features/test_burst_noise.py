"""Noise that only bursts bring: refused, and healthy bursts are not."""

import numpy as np
import pytest
from scipy.stats import chi2

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms
from afdsvc.detect.features.burst_noise import noise_compared
from afdsvc.plugins.manager import load
from benchmarks.detection.judged import judged
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

MACHINE = next(m for m in machines() if m.name == "direct feedthrough")
BURST = Burst("b", 2, 2000, 100, (Line(0, 220.0, 1.5), Line(1, 610.0, 1.5)), settle=60)


def decisions(kind: str, noisier: float, runs: int, loss=None):
    problem = problem_of(MACHINE, FalseAlarms(1e-2))
    detector = load().get("detectors", kind).design(problem, {})
    return [judged(MACHINE, problem, detector, BURST, seed, loss, noisier) for seed in range(runs)]


@pytest.mark.parametrize("kind", ["regression", "matched_filter"])
def test_noise_louder_during_bursts_is_refused(kind):
    found = decisions(kind, 1.1, 20)
    assert sum(not e.trustworthy for e in found) >= 19
    assert "times the stated standard deviation" in next(e.reason for e in found if e.reason)
    assert all(e.trustworthy for e in decisions(kind, 1.0, 20))


def test_a_fault_is_found_all_the_same():
    found = decisions("matched_filter", 1.2, 5, {"a0": -0.6})
    assert all(e.detected for e in found)


def test_an_estimated_variance_widens_the_comparison():
    known, estimated = noise_compared(2200.0, 2000.0, 0, 0.05), noise_compared(2200.0, 2000.0, 2000.0, 0.05)
    assert known[0] == pytest.approx(1.1)
    assert known[1] == pytest.approx(2 * chi2.sf(2200, 2000))
    assert estimated[1] == pytest.approx(2 * chi2.sf(1100, 1000))
    rng = np.random.default_rng(0)
    p = [noise_compared(float(a), 400.0, 0, 0.05)[1] for a in rng.chisquare(400, 4000)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.01)
