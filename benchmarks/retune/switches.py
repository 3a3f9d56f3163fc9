"""Randomised switches of Q in the compiled control sample: does any become unstable, pass a limit, or bump?

    python benchmarks/retune/switches.py --runs 50000

Every run is two switches, in and out. Drawn are the machine, what is wrong with it (the fault as diagnosed, at a severity of the interval;
or the diagnosis is wrong: no fault at all, or another one of that size), a burst, a reference that steps on the inputs or on the outputs, and
for the gas bearing a change of speed between 0 and 1100 rpm, all at any time before, during or after the switches. Limits are the machine's own,
or eight standard deviations of its loops where it has none. Bursts and references together take at most what noise leaves of them. A
limit met anywhere ends Q and counts. Bumps are ensembles of the runs without burst, reference and change of speed: the largest mean square of a signal after a
switch against that of the loops before and after. Half of the runs say where it is largest, the other half how large it is there.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from reach import turboexpander

from afdsvc.api.bursts import Limits
from afdsvc.api.detection import DetectionProblem
from afdsvc.api.retuning import DiagnosedFault, LoopCost, Tuning
from afdsvc.errors import Refused
from afdsvc.hal import control_sample
from afdsvc.hal.excitation import RunningQ
from afdsvc.lti.lft import star
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import retuned_interconnection
from afdsvc.plants.gas_bearing import FASTEST_RPM, gas_bearing
from afdsvc.retune.bounds import possible_faults
from afdsvc.retune.cost import loop_cost
from afdsvc.retune.design import design_q
from afdsvc.retune.proof import Proof, Switch, judged_models, proved_tuning
from afdsvc.testing.machines import bearing_problem, random_problem, unstable_problem

STAGE = 500  # samples before the switch in, between both, and after the switch out
REFRESH = 50  # samples between two plants of a machine whose speed changes
NOISE_PEAK = 6.5  # standard deviations left for noise: passed with probability 8e-11 per sample
MEMORY = 3000  # samples of impulse responses


@dataclass
class Case:
    """A machine with a proved tuning; its plant with faults at a speed, peaks of excitations, and what the runs add up to."""

    name: str
    problem: DetectionProblem
    found: DiagnosedFault
    cost: LoopCost
    tuning: Tuning
    proof: Proof
    limits: Limits
    plant: Callable[[dict[str, float], float], StateSpace]
    turns: bool
    wrong: list[dict[str, float]]
    room: np.ndarray  # (3, m or p): the largest alpha, step on inputs, step on outputs
    squares: dict[Any, np.ndarray] = field(default_factory=dict)
    counts: Counter[Any] = field(default_factory=Counter)


def listed() -> Iterator[tuple[str, DetectionProblem, str, dict[str, Any], Callable[..., StateSpace] | None]]:
    """Yield name, machine, fault, weights, and the plant at a speed of those that turn."""
    for seed in range(20):
        yield f"drawn {seed}", random_problem(seed), ("actuator_0", "sensor_1", "actuator_1", "sensor_0")[seed % 4], {}, None
    faults, published = bearing_problem().fault_names, {"state_weight": gas_bearing().recommended["lqg"]["state_weight"]}
    plants = {rpm: gas_bearing(rpm).faults() for rpm in np.linspace(0, FASTEST_RPM, 12)}

    def turning(severities: dict[str, float], share: float) -> StateSpace:
        return plants[min(plants, key=lambda r: abs(r - share * FASTEST_RPM))].close(severities)

    for k, (rpm, kind) in enumerate([(0, "lqg"), (0, "proportional"), (FASTEST_RPM, "lqg"), (FASTEST_RPM, "proportional")]):
        problem = bearing_problem(kind, rpm)
        disturbed = {"process_weight": 0.01 * problem.plant.B @ problem.plant.B.T}
        yield f"bearing {rpm} {kind}", problem, faults[k], disturbed, turning
        yield f"bearing {rpm} {kind}, published weights", problem, faults[3 - k], {**published, **disturbed}, turning
    yield "P4", unstable_problem(), "b2", {"input_weight": 0.1}, None
    name, problem, weights = next(turboexpander())
    yield name, problem, problem.fault_names[0], weights, None


def cases(only: str, severity: float) -> list[Case]:
    """Return the machines whose Q was proved."""
    made = []
    for name, problem, fault, weights, turning in listed():
        if only not in name:
            continue
        found, own = DiagnosedFault(fault, severity - 0.05, severity + 0.05), problem.limits if problem.limits and max(problem.limits.input) < 1e5 else None
        free = replace(problem, limits=own)
        cost = loop_cost(free, weights)
        try:
            Q = design_q(free, found, cost)
            limits = own or _wide(free, found, cost, Q)
            bounded = replace(free, limits=limits)
            tuning, proof = proved_tuning(bounded, found, cost, Q)
        except Refused as why:
            print(f"{name} {fault}: refused: {why}", flush=True)
            continue
        wrong = [case for case in possible_faults(problem, found) if fault not in case]

        def fixed(severities: dict[str, float], share: float, problem: DetectionProblem = problem) -> StateSpace:
            return problem.augmented.close(severities)

        case = Case(f"{name} {fault}", bounded, found, cost, tuning, proof, limits, turning or fixed, bool(turning), wrong, np.zeros((3, 0)))
        case.room = _room(case)
        made.append(case)
    return made


def _wide(problem: DetectionProblem, found: DiagnosedFault, cost: LoopCost, Q: StateSpace) -> Limits:
    m, p = problem.plant.inputs, problem.plant.outputs
    bound = 8 * Switch.of(judged_models(problem, found, cost, 5), Q, m, p).larger.max(axis=0)
    return Limits(bound[m:], bound[:m], 10 * bound[:m])


def _room(case: Case) -> np.ndarray:
    """Return how large alpha, a step on the inputs, or one on the outputs may be: half of what noise leaves, by sums of impulse responses."""
    problem, Q, m, p = case.problem, case.tuning.Q, case.problem.plant.inputs, case.problem.plant.outputs
    switch = Switch.of(judged_models(problem, case.found, case.cost, 3), Q, m, p)
    left = np.concatenate([case.limits.input, case.limits.output]) - NOISE_PEAK * switch.larger.max(axis=0)
    speeds = (0.0, 1.0) if case.turns else (0.0,)
    plants = [case.plant(severities, s) for severities in possible_faults(problem, case.found) for s in speeds]
    largest = np.max([_sums(G, retuned_interconnection(problem.interconnection, Q, g), m, p) for G in plants for g in (0.0, 1.0)], axis=0)
    most = np.min(0.5 * np.maximum(left, 0)[:, None] / largest, axis=0)
    return np.array([most[p + m :].min(), most[:m].min(), most[m : m + p].min()])


def _sums(G: StateSpace, J: StateSpace, m: int, p: int) -> np.ndarray:
    """Return the sums of moduli of the impulse responses from steps on inputs and outputs, and alpha, to u and y."""
    B = np.hstack([G.B, np.zeros((G.order, p)), G.B])
    D = np.zeros((m + 2 * p, 2 * m + p))
    D[:m, m + p :], D[m : m + p, m : m + p], D[m + p :, m : m + p] = np.eye(m), np.eye(p), np.eye(p)
    loop = star(StateSpace(G.A, B, np.vstack([np.zeros((m, G.order)), G.C, G.C]), D, G.dt), J, p, m)
    total, x = np.abs(loop.D[: m + p]), loop.B
    for _ in range(MEMORY):
        total, x = total + np.abs(loop.C[: m + p] @ x), loop.A @ x
    return total


def run(case: Case, rng: np.random.Generator) -> str:
    """Simulate one run; return what went wrong, "" when nothing did."""
    problem, cost, m, p = case.problem, case.cost, case.problem.plant.inputs, case.problem.plant.outputs
    kind = rng.choice(["diagnosed", "wrong"], p=[0.7, 0.3])
    severity = float(rng.uniform(case.found.low, case.found.high))
    truth = {case.found.fault: severity} if kind == "diagnosed" else dict.fromkeys(case.wrong[rng.integers(len(case.wrong))], severity)
    K, q = control_sample.contiguous_system(problem.interconnection), RunningQ(m, p, problem.plant.dt)
    n = 3 * STAGE
    excited, referred, turned = rng.random() < 0.3, rng.random() < 0.3, case.turns and rng.random() < 0.5
    # process noise enters where the inputs do: the disturbances of these cases act on u
    size = np.sqrt(np.trace(cost.process) / np.trace(problem.plant.B @ problem.plant.B.T))
    force, noise = size * rng.standard_normal((n, m)), rng.standard_normal((n, p)) @ np.linalg.cholesky(cost.noise).T
    alpha, share = np.zeros((n, m)), _speed(case, rng, n) if turned else np.full(n, float(problem.machine.startswith("gas bearing, 1100")))
    if excited:
        start, length = int(rng.integers(0, n - STAGE)), int(rng.integers(100, STAGE))
        sine = np.sin(rng.uniform(0.02, 2.0) * np.arange(length) + rng.uniform(0, 6.3)) * np.hanning(length)
        alpha[start : start + length, int(rng.integers(m))] = rng.uniform() * case.room[0] * sine
    if referred:
        at, onto = int(rng.integers(0, n)), int(rng.integers(2))
        target = (force, noise)[onto]
        target[at:, int(rng.integers(target.shape[1]))] += rng.uniform(-1, 1) * case.room[1 + onto]
    said = f"truth {truth}, burst {excited}, reference {referred}, speed {turned}"
    G = control_sample.contiguous_system(case.plant(truth, share[0]))
    x, xk, u_hold, seen = np.zeros(G.order), np.zeros(K.order), np.zeros(m), np.empty((n, m + p))
    for a in range(0, n, REFRESH if turned else STAGE):
        span = slice(a, a + (REFRESH if turned else STAGE))
        if turned:
            G = control_sample.contiguous_system(case.plant(truth, share[a]))
        if a == STAGE:
            q.begin(case.tuning, lambda: "", "q")
        elif a == 2 * STAGE:
            q.end("asked")
        u, y, beta = np.empty((span.stop - a, m)), np.empty((span.stop - a, p)), np.empty((span.stop - a, p))
        cause, _ = control_sample.run_closed_loop(
            G.A, G.B, G.C, x, K.A, K.B, K.C, K.D, xk, q.q, q.motion, alpha[span], force[span], noise[span], True,
            case.limits.output, case.limits.input, u_hold, u, y, beta,
        )  # fmt: skip
        if cause != control_sample.NO_CAUSE:
            return f"{said}, samples from {a}: cause {cause}"
        seen[span] = np.hstack([u, y])
    if not (np.isfinite(seen).all() and q.gain == 0):
        return f"{said}: not finite, or Q not at rest"
    case.counts["wrong diagnosis"] += kind == "wrong"
    case.counts["burst"] += excited
    case.counts["reference"] += referred
    case.counts["speed"] += turned
    if kind == "diagnosed" and not (excited or referred or turned):
        half = case.counts["quiet"] % 2
        case.squares[half] = case.squares.get(half, 0.0) + seen**2
        case.counts["quiet"] += 1
    return ""


def _speed(case: Case, rng: np.random.Generator, n: int) -> np.ndarray:
    """Return the share of the highest speed, sample by sample: a ramp up or down of any length."""
    start, length = rng.integers(0, n), rng.integers(1, STAGE)
    up = np.clip((np.arange(n) - start) / length, 0, 1)
    return up if rng.random() < 0.5 else 1 - up


def bump(case: Case) -> tuple[float, float]:
    """Return the largest deviation in the 250 samples after each switch relative to the loops before and after, and its standard error."""
    ratios, half = [], STAGE // 2
    for k in (0, 1):
        mean = case.squares[k] / ((case.counts["quiet"] + 1 - k) // 2)
        own = np.maximum(mean[half:STAGE].mean(axis=0), mean[STAGE + half : 2 * STAGE].mean(axis=0))
        ratios.append(np.sqrt(np.concatenate([mean[STAGE : STAGE + half], mean[2 * STAGE : 2 * STAGE + half]]) / own))
    return float(ratios[1].ravel()[np.argmax(ratios[0])]), float(1 / np.sqrt(case.counts["quiet"]))


def main() -> None:
    """Print what went wrong, the bumps, and the 95 % bound on the probability of a failure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=50_000)
    parser.add_argument("--only", default="")
    parser.add_argument("--severity", type=float, default=-0.3, help="middle of the interval that was diagnosed")
    options = parser.parse_args()
    made, rng, failures = cases(options.only, options.severity), np.random.default_rng(2026), 0
    for k in range(options.runs):
        case = made[k % len(made)]
        wrong = run(case, rng)
        if wrong:
            failures += 1
            print(f"{case.name}: {wrong}", flush=True)
        if (k + 1) % 5000 == 0:
            print(f"{2 * (k + 1)} switches, {failures} failures so far", flush=True)
    for case in made:
        proof, (measured, error) = case.proof, bump(case)
        print(
            f"{case.name:45} order {case.tuning.Q.order:2d}, in over {proof.rise_seconds:g} s, out over {proof.fall_seconds:g} s, "
            f"bump {max(proof.bump_in, proof.bump_out):.3f} exact, {measured:.3f} +- {error:.3f} measured"
        )
    counted = sum((case.counts for case in made), Counter())
    print(", ".join(f"{counted[key]} runs with {key}" for key in ("wrong diagnosis", "burst", "reference", "speed", "quiet")))
    print(f"{2 * options.runs} switches, {failures} failures (probability below {3 / (2 * options.runs) if not failures else float('nan'):.1e} with 95 % confidence)")


if __name__ == "__main__":
    main()
