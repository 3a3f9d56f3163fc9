"""How well bearing stiffness is found through S(theta): the published setting, then noise, unbalance, several at once.

    python benchmarks/rotor/identify.py --runs 100
    python benchmarks/rotor/identify.py --only-coverage --runs 110 --seed 3000
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))
from loop import full_plant, record, without_rotation

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.identify.methods.indirect import fit_indirect
from afdsvc.identify.methods.repeated_indirect import NoiseCovariances, fit_recentred
from afdsvc.identify.parameters.structure import physical_structure
from afdsvc.plants.amb_turboexpander import amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg

SETTLED = 3000  # samples


def published(full: bool, theta: float = -0.5, states: int = 8) -> float:
    """Return the relative change found from 0.5 s of a random binary signal at 1 ms (P1 section 4), without noise."""
    plant = amb_turboexpander(sample_time=1e-3, states=states)
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    change = {"stiffness_b_y": plant.parameters["stiffness_b_y"].value * (1 + theta)}
    true = full_plant(plant.values(change), 31500, 1e-3) if full else plant.discrete(**change)
    alpha = 0.02 * np.random.default_rng(1).choice([-1.0, 1.0], size=(500, 4))
    run = record(true, fact, alpha, np.random.default_rng(2))
    fit = fit_indirect(physical_structure(plant, ["stiffness_b_y"]), fact, [InputOutputData.of(alpha, run.beta, 1e-3)])
    return fit.parameters[0].value / plant.parameters["stiffness_b_y"].value - 1


def deviations(seed: int, change: dict[str, float], full: bool, project: bool = True, rounds: int = 6, samples: int = 10000, states: int = 8) -> dict:
    """Return theta, its standard error and the error in standard errors, by name, with 0.5 um noise and G2.5 unbalance."""
    plant = amb_turboexpander(states=states)
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    nominal = plant.values()
    values = plant.values({name: nominal[name] * (1 + th) for name, th in change.items()})
    true = full_plant(values, 31500, plant.sample_time) if full else plant.discrete(**{n: values[n] for n in change})
    rng = np.random.default_rng(seed)
    alpha = 0.05 * np.repeat(rng.choice([-1.0, 1.0], size=((samples + SETTLED) // 10, 4)), 10, axis=0)
    run = record(true, fact, alpha, rng, 0.5, 31500)
    steady = slice(SETTLED, None)  # the whirl has settled
    signals = [without_rotation(s[steady], run.angle[steady]) if project else s[steady] for s in (run.u, run.y)]
    recording = InputOutputData.of(*signals, plant.sample_time)
    fit = fit_recentred(physical_structure(plant, list(change)), fact, [recording], NoiseCovariances(plant.output_cov), rounds=rounds)
    return {
        p.name: (p.value / nominal[p.name] - 1, p.sd / abs(nominal[p.name]), (p.value - values[p.name]) / p.sd)
        for p in fit.parameters
    } | {"peak": float(np.abs(run.y).max())}


FOUR = dict(zip(("stiffness_a_x", "stiffness_a_y", "stiffness_b_x", "stiffness_b_y"), (-0.1, 0.2, -0.3, -0.5), strict=True))


def coverage(runs: int, full: bool, project: bool = True, states: int = 8, first: int = 1000) -> str:
    """Return how often intervals of 95 and 99.7 % hold the truth, four stiffnesses at once, and how errors compare to them."""
    errors = []
    for seed in range(runs):
        found = deviations(first + seed, FOUR, full, project, states=states)
        errors.append([found[name][2] for name in FOUR])
        print("  run", seed, "errors in standard errors:", np.round(errors[-1], 2), flush=True)
    e = np.array(errors)
    reported = []
    for sds, level in ((1.96, 0.95), (3.0, 0.9973)):
        inside = int((np.abs(e) <= sds).sum())
        low, high = (beta.ppf(q, a, b) for q, a, b in ((0.005, inside, e.size - inside + 1), (0.995, inside + 1, e.size - inside)))
        reported.append(f"{inside}/{e.size} within {sds} standard errors (promised {level:.2%}, 99 % interval of the share {low:.3f} to {high:.3f})")
    size = np.sqrt(np.mean(e**2))
    return f"{'; '.join(reported)}; errors over standard errors: mean {e.mean():.2f}, rms {size:.2f}, largest {np.abs(e).max():.2f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--only-coverage", action="store_true")
    parser.add_argument("--states", type=int, default=8, help="of the model and of the machine, with --only-coverage")
    parser.add_argument("--full", action="store_true", help="320 states of the machine, with --only-coverage")
    parser.add_argument("--seed", type=int, default=1000, help="of the first run")
    wanted = parser.parse_args()
    if wanted.only_coverage:
        print(coverage(wanted.runs, wanted.full, True, wanted.states, wanted.seed))
        sys.exit()
    print("published setting, 8 states on 8:", published(False), " on the full model:", published(True), flush=True)
    print("one stiffness, noise and unbalance:", {k: np.round(v, 4) for k, v in deviations(0, {"stiffness_b_y": -0.5}, True).items()}, flush=True)
    print("four at once:", {k: np.round(v, 4) for k, v in deviations(0, FOUR, True).items()}, flush=True)
    for full, project, runs in ((False, True, wanted.runs), (True, True, wanted.runs // 4), (False, False, wanted.runs // 4)):
        machine, treatment = "320 states" if full else "8 states", "projected out" if project else "left in"
        print(f"{machine}, unbalance {treatment}: {coverage(runs, full, project, first=wanted.seed)}", flush=True)
