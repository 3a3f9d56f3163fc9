"""How well bearing stiffness is found through S(theta): the published setting, then noise, unbalance, several at once.

    python benchmarks/rotor/identify.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from loop import full_plant, record, without_rotation

from afdsvc.identify.indirect import fit_indirect
from afdsvc.identify.recordings import Recording
from afdsvc.identify.structure import physical_structure
from afdsvc.lti.whitening import whitening_filter
from afdsvc.plants.amb_turboexpander import amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg


def published(full: bool, theta: float = -0.5, states: int = 8) -> float:
    """Return the relative change found from 0.5 s of a random binary signal at 1 ms (P1 section 4), without noise."""
    plant = amb_turboexpander(sample_time=1e-3, states=states)
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    change = {"stiffness_b_y": plant.parameters["stiffness_b_y"].value * (1 + theta)}
    true = full_plant(plant.values(change), 31500, 1e-3) if full else plant.discrete(**change)
    alpha = 0.02 * np.random.default_rng(1).choice([-1.0, 1.0], size=(500, 4))
    run = record(true, fact, alpha, np.random.default_rng(2))
    fit = fit_indirect(physical_structure(plant, ["stiffness_b_y"]), fact, [Recording.of(alpha, run.beta, 1e-3)])
    return fit.parameters[0].value / plant.parameters["stiffness_b_y"].value - 1


def deviations(seed: int, change: dict[str, float], full: bool, project: bool = True, samples: int = 5000) -> dict:
    """Return theta, its standard error and the error in standard errors, by name, with 0.5 um noise and G2.5 unbalance."""
    plant = amb_turboexpander(states=16 if full else 8)
    fact = Lqg().design(plant.discrete(), plant.recommended["lqg"]).factorisation
    nominal = plant.values()
    values = plant.values({name: nominal[name] * (1 + th) for name, th in change.items()})
    true = full_plant(values, 31500, plant.sample_time) if full else plant.discrete(**{n: values[n] for n in change})
    rng = np.random.default_rng(seed)
    alpha = 0.05 * np.repeat(rng.choice([-1.0, 1.0], size=(samples // 10, 4)), 10, axis=0)
    run = record(true, fact, alpha, rng, 0.5, 31500)
    beta = without_rotation(run.beta, run.angle) if project else run.beta
    whitener, _ = whitening_filter(fact, plant.output_cov)
    fit = fit_indirect(
        physical_structure(plant, list(change)), fact, [Recording.of(alpha, beta, plant.sample_time)], 2, whitener
    )
    return {
        p.name: (p.value / nominal[p.name] - 1, p.sd / abs(nominal[p.name]), (p.value - values[p.name]) / p.sd)
        for p in fit.parameters
    } | {"peak": float(np.abs(run.y).max())}


if __name__ == "__main__":
    print("published setting, 8 states on 8:", published(False), " on the full model:", published(True))
    one = {"stiffness_b_y": -0.5}
    four = dict(zip(("stiffness_a_x", "stiffness_a_y", "stiffness_b_x", "stiffness_b_y"), (-0.1, 0.2, -0.3, -0.5), strict=True))
    for full in (False, True):
        for change in (one, four):
            for project in (True, False):
                for seed in range(2):
                    print(full, project, {k: np.round(v, 4) for k, v in deviations(seed, change, full, project).items()}, flush=True)
