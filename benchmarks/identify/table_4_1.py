"""The three conditions of the thesis' table 4.1 repeated in simulation, beside the published figures.

python benchmarks/identify/table_4_1.py [repetitions]     (default 5; two minutes)
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402
from bearing import PLANT, binary, controller, run, stabilises  # noqa: E402
from contest import FREE, METHODS, OUTPUT_RMS, SAMPLES, amplitude, identify_all, r2, scaled_continuous, scaled_discrete  # noqa: E402
from page import table, write  # noqa: E402

from afdsvc.api.plant import PhysicalPlant  # noqa: E402
from afdsvc.dataset.arrays import InputOutputData  # noqa: E402
from afdsvc.identify.methods.hansen import youla_signals  # noqa: E402
from afdsvc.lti.coprime import Factorisation  # noqa: E402
from afdsvc.lti.sampling import sample_zoh  # noqa: E402
from afdsvc.lti.simulate import simulate  # noqa: E402
from afdsvc.lti.statespace import Array, StateSpace  # noqa: E402
from afdsvc.lti.yjbk import closed_loop  # noqa: E402
from afdsvc.plants.gas_bearing import gas_bearing  # noqa: E402

RPM = 1100
#: Table 4.1 of the thesis, R2 in per cent, horizontal and vertical.
PUBLISHED = {
    "0.7 B, rotating": {"nominal": (51.36, 54.13), "PEM": (62.87, 75.78), "Hansen G(S)": (61.94, 69.19), "Hansen, truncated": (60.71, 69.33)},
    "0.5 A, 0 rpm": {"nominal": (3.19, 3.0), "PEM": (48.91, 39.47), "Hansen G(S)": (76.76, 83.58), "Hansen, truncated": (76.73, 83.53)},
    "0.97 A, 0 rpm": {"nominal": (83.21, 76.12), "PEM": (83.9, 84.63), "Hansen G(S)": (83.53, 81.18), "Hansen, truncated": (83.07, 79.59)},
}


@dataclass(frozen=True)
class Condition:
    """One column of the table: the machine, the nominal model, where PEM starts, and the shaking of the rotor [um]."""

    published: str
    variant: str
    plant: PhysicalPlant
    nominal: StateSpace
    start: Array
    shaking: float = 0.0


def conditions() -> list[Condition]:
    values, rotating = np.array([PLANT.parameters[n].value for n in FREE]), gas_bearing(RPM)
    G = rotating.continuous()
    weak = sample_zoh(StateSpace(G.A, 0.7 * G.B, G.C, G.D, 0.0), rotating.sample_time)
    turning = np.array([rotating.parameters[n].value * (0.7 if n.startswith("gain") else 1.0) for n in FREE])
    return [
        Condition("0.7 B, rotating", "no unbalance", rotating, weak, turning),
        Condition("0.7 B, rotating", "unbalance 1 um", rotating, weak, turning, 1.0),
        Condition("0.5 A, 0 rpm", "sampled A", PLANT, scaled_discrete(0.5), 0.5 * values),
        Condition("0.5 A, 0 rpm", "continuous A", PLANT, scaled_continuous(0.5), 0.5 * values),
        Condition("0.97 A, 0 rpm", "sampled A", PLANT, scaled_discrete(0.03), 0.97 * values),
        Condition("0.97 A, 0 rpm", "continuous A", PLANT, scaled_continuous(0.03), 0.97 * values),
    ]


def recorded(fact: Factorisation, case: Condition, rng: np.random.Generator) -> tuple[InputOutputData, InputOutputData]:
    """Return the recordings of (u, y) and (alpha, beta) of one run; unbalance moves the outputs and is answered to."""
    true = case.plant.discrete()
    record, signals = run(fact, true, binary(rng, SAMPLES, amplitude(fact, true)), rng)
    if not case.shaking:
        return record, signals
    angle = RPM * 2 * np.pi / 60 * np.arange(SAMPLES) * true.dt + rng.uniform(0, 2 * np.pi)
    d = np.sqrt(2) * case.shaking * np.column_stack([np.cos(angle), np.sin(angle)])
    out, _ = simulate(closed_loop(fact, true).system, np.hstack([d, np.zeros((SAMPLES, 6))]))
    shaken = InputOutputData.of(record.u + out[:, 4:6], record.y + out[:, 2:4], true.dt)
    return shaken, youla_signals(fact, shaken)


def medians(case: Condition, repetitions: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return the median R2 of every method, shape ``(2,)`` each."""
    true, fact = case.plant.discrete(), controller(case.nominal, 1e-6)
    if not stabilises(fact, true):
        raise SystemExit(f"{case}: the controller does not stabilise the plant")
    rows = []
    for _ in range(repetitions):
        (training, signals), (heldout, _) = recorded(fact, case, rng), recorded(fact, case, rng)
        found = identify_all(fact, case.nominal, true, [training], [signals], 0.0, rng, case.plant, case.start, starts=False)
        rows.append({label: r2(found.get(label), heldout) for label in METHODS})
    return {label: np.nanmedian([row[label] for row in rows], axis=0) for label in METHODS if label != "PEM, 5 starts"}


def study(repetitions: int) -> None:
    """Write docs/reference/identification-table-4-1.md."""
    rng, rows = np.random.default_rng(2), []
    for case in conditions():
        for label, ours in medians(case, repetitions, rng).items():
            theirs = PUBLISHED[case.published].get(label)
            rows.append([case.published, case.variant, label, f"{100 * ours[0]:.1f} / {100 * ours[1]:.1f}", f"{theirs[0]} / {theirs[1]}" if theirs else ""])
            print(rows[-1], flush=True)
    header = ["condition", "here", "method", f"R2 hor. / vert. [%], median of {repetitions}", "published [%]"]
    command = f"python benchmarks/identify/table_4_1.py {repetitions}"
    write("identification-table-4-1", "Table 4.1 of the thesis, in simulation", command, [INTRODUCTION, table(header, rows), READING])


INTRODUCTION = f"""The thesis (section 4.7) identified the real gas bearing from three nominal models: one with 0.7 B at rotation, one with 0.5 A and
one with 0.97 A at rest. The same three on the simulated bearing (P5 table 0.1, its noise; speed {RPM} rpm, the other one for which a
model is published, instead of 2500): the loop of P5's controller designed for the nominal model, random binary excitation in alpha
that moves the outputs by {OUTPUT_RMS} um rms, {SAMPLES} samples to fit and {SAMPLES} others to judge. R2 is Eq 4.38, 1 - ratio of norms,
so noise takes its share: *truth* is what the true plant itself reaches. "Refined" is not in the thesis."""

READING = """## Why the figures differ from the published ones

- **Noise, not the method, sets the ceiling.** Here it is what the truth reaches, 78 to 83 % without unbalance, and follows from 2 um rms of excited
  motion and the published noise; the thesis does not give the size of its excitation. That its best figures (84 / 85 %) lie close to it says that
  its ratio of signal to noise was about this one. Compare every figure with the truth of its own row.
- **0.5 A.** Either reading of "A" (sampled or continuous) leaves a nominal model that explains next to nothing, within 1 % of zero here,
  3 % published. With the sampled A the Hansen scheme reaches the ceiling at any order, as published (77 / 84 %). With the continuous A the
  deviation S is large and lightly damped, G(S) from 2000 samples falls short of the ceiling and its truncation loses much (48 / 59 %); fitting
  the truncated plant to the recording again brings it back to the ceiling. The published figures, equal before and after truncation, look like the former.
- **Direct PEM at 0.5 A** came out at 49 / 39 % in the thesis. Here it depends on the reading: with the sampled A the search ends in another valley of the
  likelihood (one output lost altogether in the median run), with the continuous A it arrives. A value in between is what a search stopped early or a
  mean over runs leaves. That PEM may not recover where the scheme does is the same ([Monte Carlo study](identification-monte-carlo.md)).
- **0.97 A.** Whatever identifies reaches the ceiling, as published. The nominal model is 9 to 10 points below it on the sampled matrix and
  within half a point on the continuous one; published: 0.7 and 8.5 points below the best. The published nominal model did not differ from
  the real machine by 0.97 alone.
- **0.7 B at rotation.** The nominal model loses what 30 % of missing gain costs (14 to 16 points; published 12 and 22 below the best). The published
  ceiling falls to about 63 / 76 % at 2500 rpm; in simulation without unbalance it does not. With the rotor's own orbit in the output (1 um rms) the
  truth falls to 51 %, because no input explains the orbit; about half as much would give the published height. The published difference
  between the directions is the real rotor's, which equal shaking in both does not have.
- **Unbalance is a trap for R2.** The refined estimate "explains" 77 / 76 % there, more than the truth: one of its six states has become an undamped
  mode near the speed of rotation (measured in one run: 111 rad/s, damping below 0.001; the speed is 115 rad/s), and since a prediction may choose
  its initial state, that mode draws the orbit of the recording to be judged as well. It is not a property of the plant; `identify` warns of it. Take the
  harmonics of the speed out of u and y, or identify at rest.
"""

if __name__ == "__main__":
    study(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
