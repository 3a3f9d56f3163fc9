"""Do detectors made for the loop with Q keep what they promise while it acts?

    python benchmarks/retune/detection.py --bursts 1000

The gas bearing with either controller and the Q designed for 25 to 35 % loss of an actuator, simulated sample by sample in numpy, which shares
no code with the detectors. Printed with 95 % intervals: the rate of false alarms of every detector where 0.1 per burst is promised; error and coverage of the severity,
by the detector made for the loop with Q, by the one made for the loop without it, and without Q at all; and how often a second fault, 40 % loss of the other
actuator, is named beside the first.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from scipy.stats import binomtest

from afdsvc.api.bursts import Burst, Line
from afdsvc.api.detection import DetectionProblem, DetectorDesign, Evidence, FalseAlarms, ResidualBlock
from afdsvc.api.retuning import DiagnosedFault
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.plugins.detectors.burst_detectors import FaultCurvesDesign, MatchedFilterDesign, RegressionDesign
from afdsvc.retune.cost import loop_cost
from afdsvc.retune.design import design_q, retuned_problem
from afdsvc.testing.machines import bearing_problem

QUIET, BATCH, RATE, TRUTH, SECOND = 1500, 100, 0.1, -0.3, -0.4
FIRST, OTHER = "horizontal_actuator", "vertical_actuator"
BURST = Burst("b", 2, 1500, 100, (Line(0, 300.0, 0.5), Line(1, 390.0, 0.5)))


def loop(kind: str) -> tuple[DetectionProblem, StateSpace]:
    """Return the gas bearing at rest with a controller, one fault, and the Q for it."""
    whole = bearing_problem(kind)
    problem = replace(whole, false_alarms=FalseAlarms(per_burst=RATE), augmented=whole.augmented.reordered([FIRST]))
    cost = loop_cost(problem, {"process_weight": 0.01 * problem.plant.B @ problem.plant.B.T})
    return problem, design_q(problem, DiagnosedFault(FIRST, -0.35, -0.25), cost)


def simulated(problem: DetectionProblem, Q: StateSpace, losses: tuple[float, float], bursts: int, seed: int) -> dict[str, Array]:
    """Return u, y, beta and the burst's alpha ``(samples, bursts, 2)`` of machines with sensor noise, J_K, Q and the burst."""
    rng, G, J = np.random.default_rng(seed), problem.plant, problem.interconnection
    alpha = np.vstack([np.zeros((QUIET, 2)), BURST.play(G.dt)])
    B, root = G.B * (1 + np.array(losses)), np.sqrt(np.diag(problem.output_cov))
    x, xj, xq = np.zeros((bursts, G.order)), np.zeros((bursts, J.order)), np.zeros((bursts, Q.order))
    out = {name: np.empty((len(alpha), bursts, 2)) for name in ("u", "y", "beta")}
    for k, a in enumerate(alpha):
        y = x @ G.C.T + root * rng.standard_normal((bursts, 2))
        beta = xj @ J.C[2:].T + y @ J.D[2:, :2].T
        total = a + xq @ Q.C.T + beta @ Q.D.T
        u = xj @ J.C[:2].T + y @ J.D[:2, :2].T + total
        for name, value in (("u", u), ("y", y), ("beta", beta)):
            out[name][k] = value
        x, xj, xq = x @ G.A.T + u @ B.T, xj @ J.A.T + y @ J.B[:, :2].T + total @ J.B[:, 2:].T, xq @ Q.A.T + beta @ Q.B.T
    return {**out, "alpha": np.repeat(alpha[:, None, :], bursts, axis=1)}


def decisions(problem: DetectionProblem, design: DetectorDesign, seen: dict[str, Array]) -> list[Evidence]:
    """Return the decision on every burst by a detector designed for ``problem``."""
    detector, found = design.design(problem, {}), []
    for i in range(seen["y"].shape[1]):
        parts = {name: np.ascontiguousarray(values[:, i]) for name, values in seen.items()}
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


def judged(known: DetectionProblem, design: DetectorDesign, problem: DetectionProblem, Q: StateSpace, losses: tuple[float, float], bursts: int) -> list[Evidence]:
    """Return the decisions on ``bursts`` bursts of ``problem`` with Q, by a detector made for the loop ``known``."""
    return [e for seed in range(0, bursts, BATCH) for e in decisions(known, design, simulated(problem, Q, losses, min(BATCH, bursts - seed), 11 + seed))]


def share(hits: int, of: int) -> str:
    """Return a share with its exact 95 % interval."""
    found = binomtest(hits, of).proportion_ci()
    return f"{hits} of {of} = {hits / of:.3f} ({found.low:.3f} to {found.high:.3f})"


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bursts", type=int, default=1000)
    parser.add_argument("--controllers", nargs="+", default=["proportional", "lqg"])
    options = parser.parse_args()
    n = options.bursts
    for kind in options.controllers:
        problem, Q = loop(kind)
        healed, none = retuned_problem(problem, Q), StateSpace.gain(np.zeros((2, 2)), problem.plant.dt)
        print(f"gas bearing, {kind}: Q of order {Q.order}", flush=True)
        for design in (MatchedFilterDesign(), RegressionDesign(), FaultCurvesDesign()):
            alarms = sum(e.detected for e in judged(healed, design, problem, Q, (0.0, 0.0), n))
            print(f"  false alarms of {design.name}, {RATE} promised: {share(alarms, n)}", flush=True)
        for name, known, acting in (("made for the loop with Q", healed, Q), ("made for the loop without Q", problem, Q), ("no Q acts", problem, none)):
            found = [e.severity for e in judged(known, FaultCurvesDesign(), problem, acting, (TRUTH, 0.0), n) if e.severity]
            values = np.array([s.value for s in found])
            inside = sum(s.low <= TRUTH <= s.high if s.low is not None and s.high is not None else abs(s.value - TRUTH) < 1.96 * s.sd for s in found)
            print(
                f"  severity, {name}: mean {values.mean():.4f} +- {1.96 * values.std() / np.sqrt(len(found)):.4f}, median {np.median(values):.4f}, true {TRUTH}; "
                f"{len(found)} of {n} detected; in its 95 % interval {share(inside, len(found))}", flush=True,
            )  # fmt: skip
        whole = replace(bearing_problem(kind), false_alarms=FalseAlarms(per_burst=RATE))
        both = retuned_problem(replace(whole, augmented=whole.augmented.reordered([FIRST, OTHER])), Q)
        for second, name in ((0.0, FIRST), (SECOND, f"{FIRST}+{OTHER}")):
            right = sum(e.fault == name for e in judged(both, RegressionDesign(), problem, Q, (TRUTH, second), n // 4))
            print(f"  named {name} where that is true: {share(right, n // 4)}", flush=True)


if __name__ == "__main__":
    main()
