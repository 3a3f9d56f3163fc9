"""The published statistic on a burst it cannot judge."""

from dataclasses import replace

import pytest

from afdsvc.detect.statistics.comparison import PublishedFilter
from afdsvc.errors import Refused
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.testing.machines import bearing_problem


def test_a_burst_without_a_steady_sample_is_refused_in_a_sentence():
    problem = bearing_problem()
    burst = default_burst(problem, problem.limits, 0.5, 0.4)
    ramps = replace(burst, settle=burst.samples)
    statistic = PublishedFilter(problem, False)
    with pytest.raises(Refused, match="all ramp and settling"):
        statistic.decide(statistic.start(ramps, problem.plant.dt), ramps, problem.plant.dt)
