"""Machines with published figures, ready for tests of detectors and bursts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.api.plant import PhysicalPlant
from afdsvc.lti.lft import actuator_gain, augment, sensor_gain
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.plants.examples import random_stable, unstable_second_order
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.controllers.proportional import Proportional

# P4 states Q = I with R = 0.1 for F; R = 1 for L reproduces its printed phases.
_P4 = {"state_weight": 1.0, "input_weight": 0.1, "process_weight": 1.0, "noise_weight": 1.0}


def bearing_problem(controller: str = "lqg", rpm: int = 0, per_burst: float = 1e-3) -> DetectionProblem:
    """Return the gas bearing with its four gain faults, ``controller`` ``"lqg"`` or ``"proportional"`` (k = 0.2)."""
    return _problem(gas_bearing(rpm), controller, per_burst)


def unstable_problem(per_burst: float = 1e-3, faults: Sequence[str] | None = None) -> DetectionProblem:
    """Return the open-loop unstable plant of publication P4 with faults on its two input gains."""
    return _problem(unstable_second_order(), "lqg", per_burst, faults, _P4)


def random_problem(seed: int = 0, per_burst: float = 1e-3) -> DetectionProblem:
    """Return a random stable plant of order 4 with a gain fault on both inputs and outputs and an LQ controller."""
    plant, _ = random_stable(np.random.default_rng(seed), dt=1e-3)
    cov = np.array([[0.04, 0.01], [0.01, 0.09]])
    designed, residual = Lqg().design(plant, {}), innovations(plant, cov)
    faults = [actuator_gain(plant, f"actuator_{i}", i) for i in range(2)] + [sensor_gain(plant, f"sensor_{i}", i) for i in range(2)]
    return DetectionProblem(
        "random plant", plant, augment(plant, faults), designed.interconnection, residual.filter,
        whitening_filter(designed.factorisation, cov)[0], residual.covariance, ("y0", "y1"), FalseAlarms(per_burst=per_burst),
        ("u0", "u1"), output_cov=cov,
    )  # fmt: skip


def _problem(
    physical: PhysicalPlant, kind: str, per_burst: float, faults: Sequence[str] | None = None, weights: dict[str, Any] | None = None
) -> DetectionProblem:
    plant = physical.discrete()
    settings = physical.recommended.get(kind, weights or {})
    if kind == "proportional":
        designed = Proportional().design(plant, {**settings, "gain": 0.2})
    else:
        designed = Lqg().design(plant, settings)
    residual = innovations(plant, physical.output_cov)
    whitening, _ = whitening_filter(designed.factorisation, physical.output_cov)
    directions = augment(plant, physical.gain_faults()) if not physical.usual_faults and faults is None else None
    limit = np.minimum(physical.input_limit, 1e6)
    return DetectionProblem(
        physical.name, plant, directions or physical.faults(faults), designed.interconnection, residual.filter, whitening,
        residual.covariance, tuple(v.name for v in physical.outputs), FalseAlarms(per_burst=per_burst),
        tuple(v.name for v in physical.inputs), limits=Limits(np.minimum(physical.output_limit, 1e6), limit, 10 * limit),
        output_cov=physical.output_cov,
    )


def with_rate(problem: DetectionProblem, per_burst: float = 1e-3, per_hour: float = 1 / 720) -> DetectionProblem:
    """Return the problem with other promised alarm rates."""
    return replace(problem, false_alarms=FalseAlarms(per_burst, per_hour))
