"""Passive CUSUM while references move: more information per block must not bring more alarms."""

import numpy as np
import pytest
from scipy.signal import lfilter

from afdsvc.api.detection import FalseAlarms, ResidualBlock
from afdsvc.detect.thresholds.average_run_length import boundary
from afdsvc.detect.thresholds.deflection_boundary import DeflectionBoundary
from afdsvc.lti.simulate import simulate
from afdsvc.plugins.detectors.cusum import PassiveCusumDesign
from benchmarks.detection.truth import machines
from benchmarks.detection.truth_problem import problem_of

BETWEEN = 20_000  # samples between two promised alarms


def test_references_of_five_standard_deviations_keep_the_promised_rate():
    machine, samples = next(m for m in machines() if m.name == "process noise large"), 400_000
    problem = problem_of(machine, FalseAlarms(1e-3, 3600 / (BETWEEN * machine.dt)))
    detector, rng = PassiveCusumDesign().design(problem, {"silence_seconds": 0}), np.random.default_rng(7)
    ref = lfilter([1], [1, -0.98], rng.standard_normal((samples, 2)), axis=0)
    run = machine.run(rng, np.zeros((samples, 2)), ref=ref / ref.std(axis=0) * 5 * machine.spread()[0])
    r, _ = simulate(problem.innovations, np.hstack([run["y"], run["u"]]))
    _, found = detector.step(detector.start(), ResidualBlock(0, machine.dt, r, run["beta"], run["u"], run["y"], run["alpha"]))
    assert 5 <= sum(e.detected for e in found) <= 38  # 20 promised, 99.9 %; 12 times as many where the boundary stays


def test_the_clock_is_that_of_the_run_length():
    clock = DeflectionBoundary.of(np.array([0.1, 0.2]), 1e6)
    assert clock.expected == pytest.approx(np.log([0.1, 0.2]))
    for at, b in zip(clock.log_deflection[:8], clock.boundary[:8], strict=True):
        assert b == pytest.approx(boundary(float(np.exp(at)), 1e6))
    slope = (clock.boundary[1] - clock.boundary[0]) / (clock.log_deflection[1] - clock.log_deflection[0])
    assert 1.5 < slope < 2.2  # small steps: the logarithm of the information, the square of the deflection
