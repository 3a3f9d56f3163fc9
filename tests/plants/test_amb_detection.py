"""One burst on the turboexpander at full speed: bearing, actuator and sensor faults of -20 % cross the threshold."""

from __future__ import annotations

import numpy as np
import pytest

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.excite.diagnosis_burst import Aim, default_burst
from afdsvc.excite.simulated_burst import played, simulate_burst
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.plants.amb_turboexpander import NOISE_SD, amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.detectors.burst_detectors import MatchedFilterDesign

BEFORE = 3000


@pytest.mark.long
def test_every_fault_of_a_fifth_is_detected_in_one_burst() -> None:
    plant = amb_turboexpander()
    G = plant.discrete()
    design = Lqg().design(G, plant.recommended["lqg"])
    residual = innovations(G, plant.output_cov)
    limits = Limits(plant.output_limit, plant.input_limit, 10 * plant.input_limit)
    problem = DetectionProblem(
        "turboexpander", G, plant.faults(), design.interconnection, residual.filter,
        whitening_filter(design.factorisation, plant.output_cov)[0], residual.covariance,
        tuple(v.name for v in plant.outputs), FalseAlarms(1e-3), tuple(v.name for v in plant.inputs), limits=limits,
    )  # fmt: skip
    burst = default_burst(problem, limits, aim=Aim(severity=-0.2))
    alpha = played(burst, plant.sample_time, BEFORE, 100)
    detector = MatchedFilterDesign().design(problem, {})
    for seed, name in enumerate((None, *problem.fault_names)):
        noise = NOISE_SD * np.random.default_rng(seed).standard_normal((len(alpha), 4))
        run = simulate_burst(problem, alpha, noise, {} if name is None else {name: -0.2})
        assert np.abs(run.y).max() < 5.0
        state, found = detector.start(), []
        for block in run.blocks(5000, burst, BEFORE):
            state, evidence = detector.step(state, block)
            found += evidence
        assert found[0].detected is (name is not None), (name, found[0].reason)
