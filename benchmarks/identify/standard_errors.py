"""Do the 95 % intervals of the gas bearing's parameters hold the truth in 95 % of the runs?

python benchmarks/identify/standard_errors.py [runs]        (default 500; about ten minutes)
"""

from __future__ import annotations

import os
import sys

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402
from bearing import PLANT, TRUE, binary, controller, run  # noqa: E402
from page import table, write  # noqa: E402
from scipy import stats  # noqa: E402

from afdsvc.dataset.arrays import InputOutputData  # noqa: E402
from afdsvc.identify.methods.greybox import fit_greybox  # noqa: E402
from afdsvc.identify.parameters.structure import physical_structure  # noqa: E402
from afdsvc.lti.simulate import simulate  # noqa: E402
from afdsvc.lti.statespace import StateSpace  # noqa: E402
from afdsvc.lti.yjbk import closed_loop  # noqa: E402

FREE = [n for n in PLANT.parameters if n != "mass"]
TRUTH = np.array([PLANT.parameters[n].value for n in FREE])
RATES = ("horizontal_rate", "vertical_rate")
SAMPLES, AMPLITUDE, PROCESS = 6000, 4.0, 200.0


def one(seed: int, process: bool) -> np.ndarray:
    """Return (estimate - truth) / standard error and the standard errors, from one closed-loop recording."""
    rng, fact = np.random.default_rng(seed), controller(TRUE)
    record, _ = run(fact, TRUE, binary(rng, SAMPLES, AMPLITUDE), rng)
    if process:
        record = _with_process_noise(fact, record, rng)
    start = TRUTH * (1 + 0.05 * rng.standard_normal(len(TRUTH)))
    fit = fit_greybox(physical_structure(PLANT, FREE, RATES if process else ()), [record], start=start)
    sd = np.array([e.sd for e in fit.parameters])
    return np.stack([(np.array([e.value for e in fit.parameters]) - TRUTH) / sd, sd])


def _with_process_noise(fact, record: InputOutputData, rng: np.random.Generator) -> InputOutputData:
    w = np.zeros((len(record), 6))
    w[:, 2:4] = PROCESS * rng.standard_normal((len(record), 2))
    d, _ = simulate(StateSpace(TRUE.A, np.eye(6), TRUE.C, np.zeros((2, 6)), TRUE.dt), w)
    extra, _ = simulate(closed_loop(fact, TRUE).system, np.hstack([d, np.zeros((len(d), 6))]))
    return InputOutputData.of(record.u + extra[:, 4:6], record.y + extra[:, 2:4], record.dt)


def study(runs: int) -> None:
    """Write docs/reference/identification-coverage.md."""
    parts = [
        f"Gas bearing of P5 table 0.1 in the loop of P5's controller, random binary excitation of {AMPLITUDE:g} V in alpha, {SAMPLES} samples, grey-box "
        f"prediction errors from starting values 5 % off, {runs} recordings. An interval is the estimate plus and minus 1.96 standard errors; the "
        "count of hits is binomial, so with exact intervals a parameter lies between "
        f"{100 * stats.binom.ppf(0.0005, runs, 0.95) / runs:.1f} and {100 * stats.binom.ppf(0.9995, runs, 0.95) / runs:.1f} % with probability 99.9 %. "
        "The mass only scales stiffness, damping and gain, so it is fixed."
    ]
    for process, words in ((False, "Output noise only"), (True, f"Output noise and process noise on both velocities ({PROCESS:g} um/s per sample)")):
        found = np.stack([one(seed, process) for seed in range(runs)])
        inside = 100 * (np.abs(found[:, 0]) < 1.96).mean(axis=0)
        rows = [
            [name, f"{value:.4g}", f"{100 * np.median(found[:, 1, i]) / abs(value):.2f} %", f"{inside[i]:.1f} %", f"{found[:, 0, i].mean():+.2f}", f"{found[:, 0, i].std():.2f}"]
            for i, (name, value) in enumerate(zip(FREE, TRUTH, strict=True))
        ]
        print(words, inside.min(), inside.max(), flush=True)
        parts += [
            f"## {words}",
            table(["parameter", "truth", "standard error (median)", "intervals that hold the truth", "mean of (estimate - truth)/se", "its sd"], rows),
            f"Between {inside.min():.1f} and {inside.max():.1f} % (target: 92 to 98 %).",
        ]
    write("identification-coverage", "Do the standard errors cover?", f"python benchmarks/identify/standard_errors.py {runs}", parts)


if __name__ == "__main__":
    study(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
