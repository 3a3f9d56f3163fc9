"""A known fault is named also where one line of one output would leave it open whether it is none of the known ones."""

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.bursts import Limits
from afdsvc.detect.isolation import NONE
from afdsvc.detect.statistics.matched_filter import MatchedFilter
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.testing.machines import unstable_problem
from benchmarks.support.trials import trials

LOOSE = Limits(np.full(1, 1e6), np.full(1, 1e6), np.full(1, 1e6))


def named(problem, burst, fault, severity, runs=60):
    """How often the fault gets the weight that singles it out, and the mean weight of none of these."""
    statistic, source, found = MatchedFilter(problem, (), likelihood=True), trials(problem, burst, {fault: severity}), []
    for seed in range(runs):
        sums, _ = statistic.step(statistic.start(burst, problem.plant.dt), source.samples(source.noise(seed)))
        finding = statistic.decide(sums, burst, problem.plant.dt)[0]
        found.append((finding.statistic > finding.threshold and finding.weights.get(fault, 0) >= 0.99, finding.weights.get(NONE, 0)))
    return np.mean(found, axis=0)


@pytest.mark.parametrize(("fault", "severity"), [("b1", -0.1), ("b2", -0.3)])
def test_two_lines_of_the_same_power_name_the_fault_of_an_unstable_plant(fault, severity):
    problem = unstable_problem()
    two = default_burst(problem, LOOSE, 0.6, 1.5)
    strongest = max(two.lines, key=lambda line: line.omega)
    one = replace(two, lines=(replace(strongest, amplitude=np.sqrt(2) * strongest.amplitude),))
    often, none = named(problem, two, fault, severity)
    assert often > 0.75
    assert none < 0.5 * named(problem, one, fault, severity)[1]
