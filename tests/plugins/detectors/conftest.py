"""Runs of the gas bearing that detectors are shown."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from afdsvc.api.detection import DetectionProblem, Detector
from afdsvc.api.evidence import Evidence
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.simulated_burst import SimulatedBurst, played, simulate_burst
from afdsvc.testing.machines import bearing_problem

QUIET = 3000  # samples before the burst


@pytest.fixture(scope="session")
def bursts() -> Callable:
    """Return the problem and its diagnosis burst of 2.5 s, by controller, speed and output amplitude."""
    known: dict = {}

    def make(controller: str = "lqg", rpm: int = 0, amplitude: float | None = None, seconds: float = 2.5):
        key = (controller, rpm, amplitude, seconds)
        if key not in known:
            problem = bearing_problem(controller, rpm)
            known[key] = problem, default_burst(problem, problem.limits, seconds, amplitude)
        return known[key]

    return make


@pytest.fixture(scope="session")
def run() -> Callable:
    """Return a recorded burst: ``run(problem, burst, severities, seed)``."""

    def make(problem: DetectionProblem, burst, severities=None, seed=0, after=50) -> SimulatedBurst:
        alpha = played(burst, problem.plant.dt, QUIET, after)
        v = np.random.default_rng(seed).normal(size=(len(alpha), problem.plant.outputs))
        return simulate_burst(problem, alpha, v @ np.linalg.cholesky(problem.covariance).T, severities or {})

    return make


@pytest.fixture(scope="session")
def shown() -> Callable:
    """Return the evidence of a detector: ``shown(detector, rehearsal, burst, size)``; ``spoil`` changes blocks."""

    def make(detector: Detector, record: SimulatedBurst, burst, size=500, spoil=lambda block: block) -> list[Evidence]:
        state, found = detector.start(), []
        for block in record.blocks(size, burst, QUIET):
            state, evidence = detector.step(state, spoil(block))
            found += evidence
        return found

    return make


@pytest.fixture
def cut() -> Callable:
    """Return a copy of a block with some of its arrays replaced."""
    return replace
