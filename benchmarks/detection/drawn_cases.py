"""Machines whose models are only roughly known, and runs of the machines they may be.

The model believed is the nominal one; its owner states relative standard deviations of some parameters. Every machine that makes
data has those parameters drawn, and for the rare alarms also a fault, weighted back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from rates_cases import RateCase, short_burst

from afdsvc.api.detection import DetectionProblem
from afdsvc.detect.features.regressors import regressors
from afdsvc.excite.simulated_burst import SimulatedBurst, played, simulate_burst
from afdsvc.lti.lft import AugmentedPlant, FaultDirection, actuator_gain, augment, sensor_gain
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plants.examples import unstable_second_order
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem
from benchmarks.support.trials import innovations_loop


@dataclass(frozen=True)
class Doubtful:
    """A case whose problem states uncertain parameters; ``together`` has parameters and faults pulled out at once."""

    case: RateCase
    together: AugmentedPlant
    about: str

    @property
    def deviations(self) -> Mapping[str, float]:
        return self.case.problem.uncertainty

    @property
    def certain(self) -> RateCase:
        """The same machine taken as exactly known."""
        return replace(self.case, problem=replace(self.case.problem, uncertain=None, uncertainty={}))


def _bearing(controller: str) -> Doubtful:
    problem, sd = bearing_problem(controller), {"stiffness_hh": 0.01, "damping_vv": 0.01}
    plant = gas_bearing()
    word = "LQG" if controller == "lqg" else "proportional"
    together = plant.faults([*sd, *problem.fault_names])
    return _doubtful(
        f"{controller}-0",
        f"gas bearing, {word}",
        problem,
        plant.faults(list(sd)),
        sd,
        together,
        "stiffness_hh and damping_vv",
        0.8,
    )


def _unstable() -> Doubtful:
    problem, plant, sd = unstable_problem(), unstable_second_order(), {"a11": 0.01}
    return _doubtful(
        "unstable",
        "unstable plant of P4",
        problem,
        plant.faults(["a11"]),
        sd,
        plant.faults(["a11", *problem.fault_names]),
        "a11",
        4.0,
    )


def _random() -> Doubtful:
    problem = random_problem()
    plant, first = problem.plant, np.eye(problem.plant.order)[:, :1]
    none = np.zeros
    a00 = FaultDirection("a00", plant.A[0, 0] * first, none((plant.outputs, 1)), first.T, none((1, plant.inputs)), none((1, 1)))
    gains = [actuator_gain(plant, f"actuator_{i}", i) for i in range(2)] + [
        sensor_gain(plant, f"sensor_{i}", i) for i in range(2)
    ]
    return _doubtful(
        "random",
        "random plant of order 4",
        problem,
        augment(plant, [a00]),
        {"a00": 0.05},
        augment(plant, [a00, *gains]),
        "a00",
        4.0,
    )


def _doubtful(
    key: str,
    title: str,
    problem: DetectionProblem,
    uncertain: AugmentedPlant,
    sd: Mapping[str, float],
    together: AugmentedPlant,
    names: str,
    amplitude: float,
) -> Doubtful:
    burst = short_burst(problem, amplitude)
    stated = replace(problem, uncertain=uncertain, uncertainty=dict(sd))
    each = max(sd.values())
    return Doubtful(
        RateCase(key, title, stated, burst), together, f"{names} known to {100 * each:g} %, {amplitude:g} units of output"
    )


CASES: dict[str, Callable[[], Doubtful]] = {
    "unstable": _unstable, "random": _random, "proportional-0": lambda: _bearing("proportional"), "lqg-0": lambda: _bearing("lqg"),
}  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A machine that makes data: loop from ``[e, alpha]``, root of the covariance of e, filter from ``[y; u]`` back to e."""

    loop: StateSpace
    root: Array
    own: StateSpace

    def log_density(self, run: SimulatedBurst) -> float:
        """Return the log density of a record, up to a constant all machines share."""
        e, _ = simulate(self.own, np.hstack([run.y, run.u]))
        white = np.linalg.solve(self.root, e.T)
        return float(-0.5 * np.sum(white**2) - len(e) * np.sum(np.log(np.diag(self.root))))


class Playground:
    """Plays the burst of a doubtful case on machines of any parameters and faults."""

    def __init__(self, doubtful: Doubtful) -> None:
        problem, case = doubtful.case.problem, doubtful.case
        self.problem, self.filters = problem, regressors(problem)
        self.truth = replace(problem, augmented=doubtful.together, uncertain=None, uncertainty={}, severity_range=(-1.0, 1.0))
        self.before = self.filters.settling(1e-3)
        self.alpha = played(case.burst, case.dt, self.before)

    def machine(self, severities: Mapping[str, float]) -> Machine:
        """Return a machine with these relative changes of parameters and faults."""
        return Machine(*innovations_loop(self.truth, severities))

    def play(self, machine: Machine, rng: np.random.Generator) -> tuple[Array, SimulatedBurst]:
        """Return normalised residual and regressors ``(n, 1 + K, p)`` of the burst, and the whole record."""
        noise = rng.normal(size=(len(self.alpha), len(machine.root))) @ machine.root.T
        run = simulate_burst(self.problem, self.alpha, noise, loop=machine.loop)
        _, series = self.filters.step(self.filters.start(), run.r, run.y, run.u)
        return series[self.before :], run
