"""How much of what the best controller of a damaged machine gains does Q gain, measured in simulation?

    python benchmarks/retune/reach.py

For every machine, controller, fault and severity (interval +- 0.03): Q is designed and proved, then plant, J_K and Q run side by side with
noise, sample by sample, beside the same machine without Q and beside an LQG controller made with scipy's Riccati solver for the
true damaged plant (same noise, plain numpy; nothing of `afdsvc.retune` simulates). Printed is the share of the oracle's reduction, or the
sentence of the refusal. Weights: "outputs" counts outputs and inputs alike, "published" are those the LQG of the thesis was designed with;
disturbances are 0.1 V (0.1 A) of white noise on every input, the sensor noise is the machine's own. "fictitious" is the process noise on every
state that the thesis' LQG was designed with, with its weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost
from afdsvc.errors import AfdsvcError
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import youla_parameter
from afdsvc.plants.amb_turboexpander import amb_turboexpander
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.plugins.controllers.lqg import Lqg
from afdsvc.plugins.controllers.pid import Pid
from afdsvc.retune.bounds import Priced, accepted, accepted_deviations, hypothetical_deviations, sensitivities
from afdsvc.retune.cost import best_controller, controlled_cost, damaged_model, h2_cost, loop_cost, model_set, with_q
from afdsvc.retune.design import descended, design_q
from afdsvc.retune.proof import prove
from afdsvc.retune.settings import RETUNE, RetuneSettings
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem

WIDE = 0.03
ENSEMBLE = 200


def machines(drawn: int) -> Iterator[tuple[str, DetectionProblem, dict[str, Any]]]:
    """Yield name, problem and weights of every machine."""
    published = {k: gas_bearing().recommended["lqg"][k] for k in ("state_weight", "input_weight")}
    fictitious = {"process_weight": gas_bearing().recommended["lqg"]["process_weight"]}
    for rpm in (0, 1100):
        for kind in ("lqg", "proportional"):
            problem = bearing_problem(kind, rpm)
            disturbed = {"process_weight": 0.01 * problem.plant.B @ problem.plant.B.T}
            yield f"bearing {rpm} {kind} outputs", problem, disturbed
            yield f"bearing {rpm} {kind} published", problem, {**published, **disturbed}
            yield f"bearing {rpm} {kind} fictitious", problem, {**published, **fictitious}
    yield "P4", unstable_problem(), {"state_weight": 1.0, "input_weight": 0.1, "process_weight": 1.0}
    for seed in range(drawn):
        yield f"drawn {seed}", random_problem(seed), {}
    yield from turboexpander()


def turboexpander() -> Iterator[tuple[str, DetectionProblem, dict[str, Any]]]:
    """Yield the turboexpander with both controllers."""
    machine = amb_turboexpander()
    plant = machine.discrete()
    base = bearing_problem()
    for name, design in (("lqg", Lqg()), ("pid", Pid())):
        made = design.design(plant, machine.recommended[name])
        yield f"turboexpander {name}", replace(
            base, machine=machine.name, plant=plant, augmented=machine.faults(), interconnection=made.interconnection,
            output_cov=machine.output_cov, process_cov=None, limits=None, covariance=machine.output_cov,
            input_names=tuple(v.name for v in machine.inputs), output_names=tuple(v.name for v in machine.outputs),
        ), {"input_weight": 1000.0, "process_weight": 0.01 * plant.B @ plant.B.T}  # fmt: skip


def simulated(problem: DetectionProblem, cost: LoopCost, severities: dict[str, float], loop: tuple[StateSpace, StateSpace | None], samples: int) -> float:
    """Return the mean of x'Wx + u'Ru over an ensemble; ``loop`` is (J_K, Q), or (K, None) for a plain controller."""
    G, (J, Q), m, rng = problem.augmented.close(severities), loop, problem.plant.inputs, np.random.default_rng(5)
    p = G.outputs
    root_w, root_v = (np.linalg.svd(M)[0] * np.sqrt(np.linalg.svd(M)[1]) for M in (cost.process, cost.noise))
    x, xj, xq = np.zeros((ENSEMBLE, G.order)), np.zeros((ENSEMBLE, J.order)), np.zeros((ENSEMBLE, Q.order if Q else 0))
    total = 0.0
    for k in range(2 * samples):
        y = x @ G.C.T + rng.standard_normal((ENSEMBLE, p)) @ root_v.T
        u = xj @ J.C[:m].T + y @ J.D[:m, :p].T
        step = xj @ J.A.T + y @ J.B[:, :p].T
        if Q:
            beta = xj @ J.C[m:].T + y @ J.D[m:, :p].T
            alpha = xq @ Q.C.T + beta @ Q.D.T
            u, step, xq = u + alpha, step + alpha @ J.B[:, p:].T, xq @ Q.A.T + beta @ Q.B.T
        if k >= samples:
            total += float(np.mean(np.einsum("ni,ij,nj->n", x, cost.state, x) + np.einsum("ni,ij,nj->n", u, cost.input, u)))
        x, xj = x @ G.A.T + u @ G.B.T + rng.standard_normal((ENSEMBLE, G.order)) @ root_w.T, step
    return total / samples


def oracle(problem: DetectionProblem, cost: LoopCost, severities: dict[str, float]) -> StateSpace:
    """Return the LQG controller of the true damaged plant, from scipy's Riccati solver alone."""
    G = problem.augmented.close(severities)
    t = np.sqrt(np.maximum(np.diag(cost.process), 1e-12 * np.diag(cost.process).max()))
    A, B, C = G.A * t[None, :] / t[:, None], G.B / t[:, None], G.C * t[None, :]
    X = solve_discrete_are(A, B, cost.state * np.outer(t, t), cost.input)
    P = solve_discrete_are(A.T, C.T, cost.process / np.outer(t, t), cost.noise)
    F = -np.linalg.solve(cost.input + B.T @ X @ B, B.T @ X @ A)
    newest = P @ C.T @ np.linalg.inv(C @ P @ C.T + cost.noise)
    inner = F @ (np.eye(len(A)) - newest @ C)
    return StateSpace((A + B @ F) @ (np.eye(len(A)) - newest @ C), (A + B @ F) @ newest, inner, F @ newest, G.dt)


def bounded(problem: DetectionProblem, cost: LoopCost, case: dict[str, float], settings: RetuneSettings) -> list[float]:
    """Return the shares that searches from many starts reach with nothing to mind but this damaged machine and the bounds on sensitivity.

    They minimise the cost and a price on sensitivities beyond their bounds (exterior penalty): the least of it is at most the cost of any Q within
    the bounds. Where all searches agree, the largest share is what the bounds allow, whatever the method of design.
    """
    ((fault, severity),) = case.items()
    found, m, p = DiagnosedFault(fault, severity, severity), problem.plant.inputs, problem.plant.outputs
    none, model = StateSpace.gain(np.zeros((m, p)), problem.plant.dt), damaged_model(problem, cost, case)
    before, best = h2_cost(with_q(model, none)), controlled_cost(problem, cost, case, oracle(problem, cost, case))
    bounds = accepted(problem, found, sensitivities(problem, found, none)[:, 0], settings)
    loudest = accepted_deviations(problem, hypothetical_deviations(problem, found, cost, none), settings)
    fit = Priced.of(model_set([model], [1 / (before - best)], m, p, 1.0), problem, found, cost, (bounds, loudest), 20.0)
    cautious = [replace(cost, input=c * cost.input, noise=c * cost.noise) for c in (3, 30)]
    starts = [youla_parameter(problem.interconnection, best_controller(problem, c, at)) for c in cautious for at in (case, {})]
    scaled = [[replace(Q, C=g * Q.C, D=g * Q.D) for g in (1, 0.5, 0.25, 0.1)] for Q in starts if Q.is_stable()]
    usable = [next((Q for Q in gains if np.isfinite(fit.cost_and_slope(Q)[0])), None) for gains in scaled]
    return [before / (before - best) - fit.cost_and_slope(descended(fit, Q, 1000))[0] for Q in usable if Q]


def main() -> None:
    """Print a line per case and the count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--drawn", type=int, default=20)
    parser.add_argument("--only", default="")
    parser.add_argument("--severities", type=float, nargs="+", default=[-0.25, -0.5])
    parser.add_argument("--sensitivity", type=float, default=RETUNE.sensitivity, help="largest sensitivity of a loop with Q")
    parser.add_argument("--if-wrong", type=float, nargs="+", default=RETUNE.sensitivity_if_wrong, help="the same where the diagnosis is wrong, tried in turn")
    parser.add_argument("--faults", nargs="+", default=[], help="only these")
    parser.add_argument("--bounded", action="store_true", help="say what the bounds on sensitivity allow where 90 %% are not reached")
    options = parser.parse_args()
    settings = replace(RETUNE, sensitivity=options.sensitivity, sensitivity_if_wrong=tuple(options.if_wrong))
    shares: list[float] = []
    refused = 0
    for name, problem, weights in machines(options.drawn):
        if options.only not in name:
            continue
        cost = loop_cost(problem, weights)
        for fault in [f for f in problem.fault_names if not options.faults or f in options.faults]:
            for severity in options.severities:
                low = max(severity - WIDE, problem.severity_range[0])
                try:
                    found = DiagnosedFault(fault, low, severity + WIDE)
                    Q = design_q(problem, found, cost, settings)
                    proof = prove(problem, found, cost, Q, settings)
                except AfdsvcError as why:
                    refused += 1
                    print(f"{name:32} {fault:22} {severity:5.2f}  refused: {why}", flush=True)
                    continue
                case, J = {fault: severity}, problem.interconnection
                samples = 800
                before, after = (simulated(problem, cost, case, (J, q), samples) for q in (None, Q))
                best = simulated(problem, cost, case, (oracle(problem, cost, case), None), samples)
                share = (before - after) / (before - best)
                shares.append(share)
                print(
                    f"{name:32} {fault:22} {severity:5.2f}  oracle gains {100 * (1 - best / before):5.1f} %, Q {100 * share:5.1f} % of it, "
                    f"order {Q.order:2d}, sensitivity {proof.sensitivity_before:.2f} to {proof.sensitivity_after:.2f}",
                    flush=True,
                )
                if options.bounded and share < 0.9:
                    allowed = bounded(problem, cost, case, settings)
                    print(f"{proof.bound}; {len(allowed)} searches within the bounds reach {100 * min(allowed):.1f} to {100 * max(allowed):.1f} %", flush=True)
    print(f"{sum(s >= 0.9 for s in shares)} of {len(shares)} reach 90 %; median {100 * np.median(shares):.1f} %, smallest {100 * min(shares):.1f} %; {refused} refused")


if __name__ == "__main__":
    main()
