"""What the recordings say of a signal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.model import Variable
from afdsvc.api.signals import Trace
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import fit
from afdsvc.explain.search.machine import _sizes, machine
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.nominal import nominal


@pytest.mark.parametrize(("low", "high", "reverses"), [(-1.0, 1.0, True), (-0.2, 1.0, True), (-0.02, 1.0, False), (0.5, 1.0, False), (-1.0, -0.5, False)])
def test_a_signal_reverses_where_both_signs_are_more_than_noise_about_rest(low, high, reverses):
    (size,) = _sizes([Variable("w", "rad/s")], np.linspace(low, high, 1000)[:, None])
    assert size.reverses is reverses


def test_a_signal_reaches_as_far_from_its_mean_as_its_peak():
    (size,) = _sizes([Variable("gap", "mm")], np.concatenate([np.full(999, 5.0), [9.0]])[:, None])
    assert size.reach == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("shift", [0.0, 10.0])
def test_a_sensor_that_lost_the_sign_reads_what_reverses_though_the_fit_does_not(spring, recorded, shift):
    """The reading is never negative; nor is the simulation, once its zero is fitted to the reading. The model as stated reverses."""
    trace = recorded(1)
    rectified: Trace = replace(trace, values=np.column_stack([trace.values[:, 0], np.abs(trace.values[:, 1])]))
    problem = build(nominal(spring, trace.dt), prepare(spring, [rectified]), Settings())
    base = fit(problem, replace(problem.start(), offset=np.array([shift])), 0.0, 1.0, iterations=0)
    assert (np.vstack([s.y for s in problem.simulated(base.point, 0.0)]) > 0).all() == (shift > 0)
    assert machine(problem, base, 0.0).outputs[0].reverses
