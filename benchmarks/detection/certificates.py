"""Drawn bursts, certified and as large as the certificate allows, played on drawn machines: is any limit passed, and what does it cost?

    python -m benchmarks.detection.certificates [--bursts N] [--seed N] [--only MACHINE ..]

Lines, phases, ramps and lengths are drawn; the machine that plays a burst has no fault or any listed fault up to the certified severity.
The simulator shares no code with the package. The power given up is that of the designed burst against the same design without certificate.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from afdsvc.api.bursts import Burst, Line
from afdsvc.detect.stability_range import reachable
from afdsvc.errors import Refused
from afdsvc.excite import diagnosis_burst
from afdsvc.excite.amplitude_budget import room
from afdsvc.excite.certificate import certificate
from benchmarks.detection.counting import share
from benchmarks.detection.truth import TrueMachine, machines
from benchmarks.detection.truth_problem import alpha_of, loss_of, problem_of

SEVERITY, ROOM, BEFORE = -0.3, 9.0, 300


def drawn(rng: np.random.Generator, machine: TrueMachine) -> Burst:
    """Return a burst of one to four lines on every input."""
    m, samples = machine.shape[1], int(rng.integers(600, 2500))
    lines = tuple(
        Line(i, float(np.exp(rng.uniform(np.log(20 / samples), np.log(2.5))) / machine.dt), float(rng.uniform(0.2, 1.0)), float(rng.uniform(0, 6.28)))
        for i in range(m) for _ in range(rng.integers(1, 5))
    )  # fmt: skip
    return Burst("drawn", m, samples, int(rng.integers(10, samples // 3)), lines)


def played(machine: TrueMachine, bursts: int, seed: int) -> tuple[int, float]:
    """Return how many of the bursts passed a limit, and the largest share of any limit that was reached."""
    problem, rng, passed, largest = problem_of(machine, room=ROOM), np.random.default_rng([seed, len(machine.name)]), 0, 0.0
    assert problem.limits is not None
    limits = replace(problem.limits, input=4 * ROOM * np.maximum(machine.spread()[1], 1e-3 * machine.spread()[1].max()))
    reach = reachable(problem)
    for _ in range(bursts):
        burst = drawn(rng, machine)
        factor = certificate(problem, limits, burst, SEVERITY).factor
        burst = replace(burst, lines=tuple(replace(line, amplitude=factor * line.amplitude) for line in burst.lines))
        fault = [None, *problem.fault_names][int(rng.integers(1 + len(problem.fault_names)))]
        loss = None if fault is None else loss_of(problem, {fault: float(rng.uniform(0, 1)) * max(SEVERITY, 0.9 * reach[fault][0])})
        run = machine.run(rng, alpha_of(burst, machine.dt, BEFORE), loss)
        share = max(float((np.abs(run[name]).max(axis=0) / bound).max()) for name, bound in (("y", limits.output), ("u", limits.input), ("alpha", limits.alpha)))
        passed, largest = passed + (share > 1 + 1e-9), max(largest, share)
    return passed, largest


def given_up(machine: TrueMachine, seconds: float) -> float:
    """Return the share of the designed burst's power that the certificate takes away."""
    problem, aim = problem_of(machine, room=ROOM), diagnosis_burst.Aim(severity=SEVERITY)
    assert problem.limits is not None
    largest = 1e6 * float(problem.limits.output.max())
    made = diagnosis_burst.default_burst(problem, problem.limits, seconds, largest, aim)
    frame = diagnosis_burst._frame(problem, seconds, "b")  # noqa: SLF001
    plan = diagnosis_burst._best_plan(problem, frame, room(problem, problem.limits), aim)  # noqa: SLF001
    return max(0.0, 1 - (float(made.notes["output_amplitude"]) / plan.largest) ** 2)


def main() -> None:
    """Play, count and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bursts", type=int, default=1000, help="for each machine")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", default=range(10), help="machines by number")
    asked, total = parser.parse_args(), [0, 0]
    print("| machine | bursts | passed a limit | largest share of a limit | power given up, 2 s and 6 s |\n|---|---|---|---|---|")
    for machine in (machines()[i] for i in asked.only):
        passed, largest = played(machine, asked.bursts, asked.seed)
        costs = []
        for seconds in (2.0, 6.0):
            try:
                costs.append(f"{100 * given_up(machine, seconds):.1f} %")
            except Refused:
                costs.append("refused")
        total = [total[0] + asked.bursts, total[1] + passed]
        print(f"| {machine.name} | {asked.bursts} | {passed} | {largest:.3f} | {', '.join(costs)} |", flush=True)
    found = share(total[1], total[0], 0.99)
    print(f"\n{total[1]} of {total[0]:,} bursts passed a limit (99 %: {found.low:.2g} to {found.high:.2g}); {time.process_time():.0f} s of processor")


if __name__ == "__main__":
    main()
