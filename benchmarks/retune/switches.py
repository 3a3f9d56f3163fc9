"""Randomised switches of Q in the compiled control sample: does any become unstable, pass a limit, or bump?

    python benchmarks/retune/switches.py --runs 50000

Every run is two switches, in and out. Drawn are the machine, the true severity (inside the interval, or 0: the diagnosis was wrong), a burst
that plays through one or both switches, and a reference that steps a disturbance on the inputs. Limits are eight standard deviations
of the loops with and without Q, beyond the noise peaks of the proof; a limit met anywhere ends Q and counts. The bump is the largest
mean square of a signal over the runs without burst and reference, sample by sample, against that of the loops before and after.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace

import numpy as np

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import Diagnosed, LoopCost, Tuning
from afdsvc.errors import Refused
from afdsvc.hal import control_sample
from afdsvc.hal.excitation import RunningQ
from afdsvc.retune.cost import loop_cost, signal_model
from afdsvc.retune.design import design_q, severity_grid
from afdsvc.retune.proof import Switch, proved_tuning
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem

STAGE = 500  # samples before the switch in, between both, and after the switch out
EXCITED = 0.02  # of the input limit: amplitude of bursts and references


@dataclass
class Case:
    """A machine with a proved tuning, and what the runs of it add up to."""

    name: str
    problem: DetectionProblem
    found: Diagnosed
    cost: LoopCost
    tuning: Tuning
    limits: Limits
    squares: dict[str, np.ndarray] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)


def cases() -> list[Case]:
    """Return the machines whose Q was proved."""
    wanted = [(f"drawn {s}", random_problem(s), f, {}) for s in range(6) for f in ("actuator_0", "sensor_1")]
    bearing = bearing_problem("proportional")
    wanted += [("bearing", bearing, f, {"process_weight": 0.01 * bearing.plant.B @ bearing.plant.B.T}) for f in bearing.fault_names[::3]]
    wanted.append(("P4", unstable_problem(), "b2", {"input_weight": 0.1}))
    made = []
    for name, problem, fault, weights in wanted:
        free, found = replace(problem, limits=None), Diagnosed(fault, -0.35, -0.25)
        cost = loop_cost(free, weights)
        try:
            Q = design_q(free, found, cost)
            models = [signal_model(free, cost, {fault: s}) for s in (*severity_grid(free, found, 5).tolist(), 0.0)]
            m, p = problem.plant.inputs, problem.plant.outputs
            bound = 8 * Switch.of(models, Q, m, p).larger.max(axis=0)
            limits = Limits(bound[m:], bound[:m], 10 * bound[:m])
            tuning, _ = proved_tuning(replace(free, limits=limits), found, cost, Q)
        except Refused as why:
            print(f"{name} {fault}: refused: {why}")
            continue
        made.append(Case(f"{name} {fault}", free, found, cost, tuning, limits))
    return made


def run(case: Case, rng: np.random.Generator) -> str:
    """Simulate one run; return what went wrong, "" when nothing did."""
    problem, cost, m, p = case.problem, case.cost, case.problem.plant.inputs, case.problem.plant.outputs
    truth = 0.0 if rng.random() < 0.3 else float(rng.uniform(case.found.low, case.found.high))
    G = control_sample.contiguous_system(problem.augmented.close({case.found.fault: truth}))
    K, q = control_sample.contiguous_system(problem.interconnection), RunningQ(m, p, G.dt)
    n, excited, referred = 3 * STAGE, rng.random() < 0.4, rng.random() < 0.4
    noise = rng.standard_normal((n, p)) @ np.linalg.cholesky(cost.noise).T
    # process noise enters where the inputs do: the disturbances of these cases act on u
    size = np.sqrt(np.trace(cost.process) / np.trace(problem.plant.B @ problem.plant.B.T))
    force = size * rng.standard_normal((n, m))
    alpha = np.zeros((n, m))
    if excited:
        start, length = int(rng.integers(0, 2 * STAGE)), int(rng.integers(100, STAGE))
        sine = np.sin(rng.uniform(0.02, 2.0) * np.arange(length) + rng.uniform(0, 6.3)) * np.hanning(length)
        alpha[start : start + length, int(rng.integers(m))] = EXCITED * case.limits.input.min() * sine
    if referred:
        force[int(rng.integers(0, n)) :, int(rng.integers(m))] += EXCITED * case.limits.input.min() * rng.choice([-1, 1])
    x, xk, u_hold = np.zeros(G.order), np.zeros(K.order), np.zeros(m)
    seen = np.empty((n, m + p))
    for stage in range(3):
        span = slice(stage * STAGE, (stage + 1) * STAGE)
        if stage == 1:
            q.begin(case.tuning, lambda: "", "q")
        elif stage == 2:
            q.end("asked")
        u, y, beta = np.empty((STAGE, m)), np.empty((STAGE, p)), np.empty((STAGE, p))
        cause, _ = control_sample.run_closed_loop(
            G.A, G.B, G.C, x, K.A, K.B, K.C, K.D, xk, q.q, q.motion, alpha[span], force[span], noise[span], True,
            case.limits.output, case.limits.input, u_hold, u, y, beta,
        )  # fmt: skip
        if cause != control_sample.NO_CAUSE:
            return f"truth {truth:.2f}, burst {excited}, reference {referred}, stage {stage}: cause {cause}"
        seen[span] = np.hstack([u, y])
    if not (np.isfinite(seen).all() and q.gain == 0):
        return "not finite, or Q not at rest"
    if not excited and not referred:
        kind = "healthy" if truth == 0 else "damaged"
        case.squares[kind] = case.squares.get(kind, 0.0) + seen**2
        case.counts[kind] = case.counts.get(kind, 0) + 1
    return ""


def bumps(case: Case) -> dict[str, float]:
    """Return the largest deviation in the 250 samples after each switch, relative to the loops before and after."""
    out = {}
    for kind, total in case.squares.items():
        mean, half = total / case.counts[kind], STAGE // 2
        own = np.maximum(mean[half:STAGE].mean(axis=0), mean[STAGE + half : 2 * STAGE].mean(axis=0))
        both = np.concatenate([mean[STAGE : STAGE + half], mean[2 * STAGE : 2 * STAGE + half]])
        out[kind] = float(np.sqrt((both / own).max()))
    return out


def main() -> None:
    """Print what went wrong, the bumps, and the 95 % bound on the probability of a failure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=50_000)
    options = parser.parse_args()
    made, rng, failures = cases(), np.random.default_rng(2026), 0
    for k in range(options.runs):
        case = made[k % len(made)]
        wrong = run(case, rng)
        if wrong:
            failures += 1
            print(f"{case.name}: {wrong}", flush=True)
    for case in made:
        rise, fall = case.tuning.rise, case.tuning.fall
        print(f"{case.name:24} order {case.tuning.Q.order:2d}, in over {rise:g} s, out over {fall:g} s, bump " + ", ".join(f"{k} {v:.3f} ({case.counts[k]} runs)" for k, v in bumps(case).items()))
    print(f"{2 * options.runs} switches, {failures} failures (probability below {3 / (2 * options.runs) if not failures else float('nan'):.1e} with 95 % confidence)")


if __name__ == "__main__":
    main()
