"""With Q in place detectors made for the loop with Q keep their rate and estimate severities without bias; made for the old loop they do not.

Monte Carlo with fixed seeds; the machine is simulated by hand, sample by sample for an ensemble, and shares no code with the detectors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import FalseAlarms, ResidualBlock
from afdsvc.api.retuning import Diagnosed
from afdsvc.lti.simulate import simulate
from afdsvc.plugins.detectors.burst_detectors import FaultCurvesDesign, MatchedFilterDesign, RegressionDesign
from afdsvc.retune.cost import loop_cost
from afdsvc.retune.design import design_q, retuned_problem
from afdsvc.testing.machines import bearing_problem

QUIET, RUNS, RATE, TRUTH = 1500, 80, 0.1, -0.3
BURST = Burst("b", 2, 1500, 100, (Line(0, 300.0, 0.5), Line(1, 390.0, 0.5)))


pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def loops():
    """Return the problem of the running loop, that of the loop with Q, and Q."""
    whole = bearing_problem("proportional")
    problem = replace(whole, false_alarms=FalseAlarms(per_burst=RATE), augmented=whole.augmented.reordered(["horizontal_actuator"]))
    cost = loop_cost(problem, {"process_weight": 0.01 * problem.plant.B @ problem.plant.B.T})
    Q = design_q(problem, Diagnosed("horizontal_actuator", -0.35, -0.25), cost)
    return problem, retuned_problem(problem, Q), Q


def machines(problem, Q, severity: float, second: float = 0.0) -> dict[str, np.ndarray]:
    """Return u, y, beta of an ensemble ``(samples, runs, 2)`` of machines with sensor noise, J_K, Q and the burst."""
    rng, G, J = np.random.default_rng(11), problem.plant, problem.interconnection
    alpha = np.vstack([np.zeros((QUIET, 2)), BURST.play(G.dt)])
    B, root = G.B * np.array([1 + severity, 1 + second]), np.sqrt(np.diag(problem.output_cov))
    x, xj, xq = np.zeros((RUNS, G.order)), np.zeros((RUNS, J.order)), np.zeros((RUNS, Q.order))
    out = {name: np.empty((len(alpha), RUNS, 2)) for name in ("u", "y", "beta")}
    for k, a in enumerate(alpha):
        y = x @ G.C.T + root * rng.standard_normal((RUNS, 2))
        beta = xj @ J.C[2:].T + y @ J.D[2:, :2].T
        total = a + xq @ Q.C.T + beta @ Q.D.T
        u = xj @ J.C[:2].T + y @ J.D[:2, :2].T + total
        for name, value in (("u", u), ("y", y), ("beta", beta)):
            out[name][k] = value
        x, xj, xq = x @ G.A.T + u @ B.T, xj @ J.A.T + y @ J.B[:, :2].T + total @ J.B[:, 2:].T, xq @ Q.A.T + beta @ Q.B.T
    return {**out, "alpha": np.repeat(alpha[:, None, :], RUNS, axis=1)}


def decisions(problem, design, seen: dict[str, np.ndarray]) -> list:
    """Return the decision on the burst of every run, by a detector designed for ``problem``."""
    detector, found = design.design(problem, {}), []
    for i in range(RUNS):
        parts = {name: np.ascontiguousarray(seen[name][:, i]) for name in seen}
        r, _ = simulate(problem.innovations, np.hstack([parts["y"], parts["u"]]))
        state = detector.start()
        for a, b, playing in ((0, QUIET, None), (QUIET, len(r), BURST)):
            block = ResidualBlock(
                a, problem.plant.dt, r[a:b], parts["beta"][a:b], parts["u"][a:b], parts["y"][a:b], parts["alpha"][a:b], playing,
                "b" if playing else "", QUIET,
            )  # fmt: skip
            state, evidence = detector.step(state, block)
        found.append(evidence[-1])
    return found


@pytest.mark.parametrize("design", [MatchedFilterDesign(), RegressionDesign()], ids=["matched_filter", "regression"])
def test_the_promised_rate_of_false_alarms_holds_with_q(loops, design):
    problem, with_q, Q = loops
    alarms = sum(e.detected for e in decisions(with_q, design, machines(problem, Q, 0.0)))
    assert binom.cdf(alarms, RUNS, RATE) > 1e-3  # 99.8 % confidence
    assert binom.sf(alarms - 1, RUNS, RATE) > 1e-3


def test_the_severity_is_unbiased_for_the_loop_with_q_and_biased_without(loops):
    problem, with_q, Q = loops
    seen, z = machines(problem, Q, TRUTH), {}
    for name, known in (("with Q", with_q), ("without", problem)):
        found = [e.severity for e in decisions(known, FaultCurvesDesign(), seen) if e.severity]
        assert len(found) > RUNS / 2
        error = np.array([s.value - TRUTH for s in found])
        z[name] = error.mean() / (error.std() / np.sqrt(len(found)))
    assert abs(z["with Q"]) < 4
    assert abs(z["without"]) > 6


def test_a_second_fault_is_named_beside_the_one_q_was_designed_for(loops):
    whole, (problem, _, Q) = bearing_problem("proportional"), loops
    both = replace(problem, augmented=whole.augmented.reordered(["horizontal_actuator", "vertical_actuator"]))
    for second, name in ((0.0, "horizontal_actuator"), (-0.4, "horizontal_actuator+vertical_actuator")):
        found = decisions(retuned_problem(both, Q), RegressionDesign(), machines(problem, Q, TRUTH, second))
        assert sum(e.fault == name for e in found) >= 0.95 * RUNS
