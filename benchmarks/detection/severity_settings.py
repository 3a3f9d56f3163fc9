"""Machines, faults and bursts of the study of severities, and the information their records hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from afdsvc.api.bursts import Burst, Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.testing.machines import bearing_problem, unstable_problem
from benchmarks.support.trials import innovations_loop, trials

NUDGE = 1e-5
RECORDS = 40  # from which the information is averaged: it hardly varies
LINES, LINEAR, ITERATED = "fault_curves, matched_filter", "regression", "iterated_regression"


@dataclass(frozen=True)
class Setting:
    """One machine with one fault; the burst's length [s] and output amplitude; which estimators are asked."""

    title: str
    make: Callable[[], DetectionProblem]
    fault: str
    severity: float
    seconds: float
    amplitude: float
    estimators: tuple[str, ...]

    def problem(self) -> DetectionProblem:
        return self.make()

    def burst(self, problem: DetectionProblem) -> Burst:
        """Return the burst played."""
        m, p = problem.plant.inputs, problem.plant.outputs
        limits = problem.limits or Limits(np.full(p, 50.0), np.full(m, 50.0), np.full(m, 50.0))
        limits = replace(limits, output=np.minimum(limits.output, 50.0))
        return default_burst(replace(problem, limits=limits), limits, self.seconds, self.amplitude)


def _bearing(controller: str, rpm: int) -> Callable[[], DetectionProblem]:
    return lambda: bearing_problem(controller, rpm)


def _stiffness() -> DetectionProblem:
    found = bearing_problem("proportional")
    return replace(found, augmented=gas_bearing().faults(["stiffness_hh", "damping_vv"]), severity_range=(-0.5, 0.0))


BOTH = (LINES, LINEAR)
SETTINGS = (
    *(
        Setting(f"bearing, {name}, {rpm} rpm, {fault} {severity:.0%}", _bearing(kind, rpm), fault, severity, 0.5, 1.0, BOTH)
        for kind, name in (("lqg", "LQG"), ("proportional", "proportional"))
        for rpm, fault, severity in ((0, "horizontal_actuator", -0.3), (1100, "vertical_sensor", -0.5))
    ),
    Setting(
        "bearing, LQG, 0 rpm, vertical_actuator -40%",
        _bearing("lqg", 0),
        "vertical_actuator",
        -0.4,
        1.0,
        1.0,
        (*BOTH, ITERATED),
    ),
    Setting("bearing, proportional, stiffness_hh -10%", _stiffness, "stiffness_hh", -0.1, 1.0, 1.0, (*BOTH, ITERATED)),
    Setting("plant of P4, b1 -10%", unstable_problem, "b1", -0.1, 0.6, 1.5, (*BOTH, ITERATED)),
    Setting("plant of P4, b2 -10%", unstable_problem, "b2", -0.1, 0.6, 1.5, (*BOTH, ITERATED)),
)


def information(setting: Setting, problem: DetectionProblem, burst: Burst, settle: int) -> tuple[float, float]:
    """Return Fisher's information of a burst's record about the severity, and that of its samples after ``settle``.

    The innovations e of the true machine are normal with covariance X, so it is ``sum |X^-1/2 de/dtheta|^2`` on average plus
    ``n tr((X^-1 dX/dtheta)^2) / 2``. Both derivatives are central differences of optimal predictors: no regressor is used.
    """
    near = [innovations_loop(problem, {setting.fault: setting.severity + s * NUDGE}) for s in (-1, 0, 1)]
    source = trials(problem, burst, {setting.fault: setting.severity})
    rng, energy = np.random.default_rng(5), np.zeros(burst.samples)
    for _ in range(RECORDS):
        _, _, run = source.whole(rng.normal(size=(len(source.alpha), len(source.root))))
        low, high = (simulate(near[i][2], np.hstack([run.y, run.u]))[0] for i in (0, 2))
        moved = np.linalg.solve(near[1][1], ((high - low) / (2 * NUDGE)).T)[:, source.before :]
        energy += np.sum(moved**2, axis=0) / RECORDS
    X: list[Array] = [root @ root.T for _, root, _ in near]
    change = np.linalg.solve(X[1], (X[2] - X[0]) / (2 * NUDGE))
    each = 0.5 * float(np.trace(change @ change))
    return float(np.sum(energy)) + each * len(energy), float(np.sum(energy[settle:])) + each * (len(energy) - settle)
