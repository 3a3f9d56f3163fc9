"""The detection problem of a true machine, its model exactly right: where the package meets the truth simulator."""

from __future__ import annotations

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem, FalseAlarms
from afdsvc.lti.coprime import observer_factorisation
from afdsvc.lti.lft import actuator_gain, augment, sensor_gain
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.whitening import innovations, whitening_filter
from afdsvc.lti.yjbk import interconnection
from benchmarks.detection.truth import TrueMachine


def problem_of(machine: TrueMachine, alarms: FalseAlarms = FalseAlarms(), room: float = 12.0) -> DetectionProblem:  # frozen
    """Return the problem with the true noise, gain faults on all actuators (``a0``, ..) and sensors (``s0``, ..), and limits of ``room``
    standard deviations of the healthy loop's outputs and inputs (at least of what such outputs take)."""
    _, m, p = machine.shape
    plant = StateSpace(machine.A, machine.B, machine.C, machine.D, machine.dt)
    fact = observer_factorisation(plant, machine.F, machine.L)
    found = innovations(plant, machine.R, machine.Q if machine.Q.any() else None)
    faults = [*(actuator_gain(plant, f"a{i}", i) for i in range(m)), *(sensor_gain(plant, f"s{i}", i) for i in range(p))]
    y, u = machine.spread()
    wide = 1e3 * np.maximum(u, u.max())
    limits = Limits(room * y, wide, 10 * wide, 60.0)
    return DetectionProblem(
        machine.name, plant, augment(plant, faults), interconnection(fact), found.filter,
        whitening_filter(fact, machine.R, machine.Q if machine.Q.any() else None)[0], found.covariance,
        tuple(f"y{i}" for i in range(p)), alarms, tuple(f"u{i}" for i in range(m)), limits=limits, output_cov=machine.R,
        process_cov=machine.Q if machine.Q.any() else None,
    )


def loss_of(problem: DetectionProblem, severities: dict[str, float]) -> np.ndarray:
    """Return the severities of actuators, then sensors, as `TrueMachine.run` takes them."""
    return np.array([severities.get(name, 0.0) for name in problem.fault_names])


def alpha_of(burst: Burst, dt: float, before: int, after: int = 0) -> np.ndarray:
    """Return alpha of a burst between quiet samples."""
    return np.vstack([np.zeros((before, burst.inputs)), burst.play(dt), np.zeros((after, burst.inputs))])
