"""Blind trials at speed: what a rotor's model leaves out, hidden by the generator and looked for by `explain`.

The rotor of `afdsvc.trial.machines` turns at 2,750 to 3,299 rad/s on magnetic bearings, unstable without its controller. The
explaining side gets MODEL.toml and recordings, nothing else.

    python benchmarks/rotor/explain.py --rho 0.3 --seeds 2
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from afdsvc.explain.pipeline import explain
from afdsvc.files.model.model_file import parse_model
from afdsvc.plugins.manager import load
from afdsvc.trial.folder import nominal_model_text
from afdsvc.trial.generate import generate_trial
from afdsvc.trial.machines import RotorOptions

PHYSICS = ("unbalance", "runout", "gyroscopic_coupling", "cross_coupled_stiffness", "flexible_mode", "nothing")


def one(physics: str, rho: float, seed: int) -> tuple[bool, str]:
    """Return whether the first name is the hidden one (or nothing was named where nothing was hidden), and a line."""
    trial = generate_trial(physics, None, rho, np.random.default_rng([seed, PHYSICS.index(physics)]), RotorOptions())
    began = time.process_time()
    model = parse_model(nominal_model_text(trial.machine), "MODEL.toml")
    found = explain(model, trial.recordings, [trial.holdout], [o.thing for o in load().family("physics")])
    first = found.named[0] if found.named else None
    right = found.verdict == "consistent" if physics == "nothing" else first is not None and first.physics == physics
    reported = "-" if first is None else f"{first.physics} at {first.site}, weight {first.weight:.2f}"
    site = trial.answer.hidden[0].site if trial.answer.hidden else ""
    return right, f"{physics} {site} rho {rho:g}: {found.verdict}; {reported}; {time.process_time() - began:.0f} s"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--rho", type=float, default=0.3)
    parser.add_argument("--seeds", type=int, default=2)
    wanted = parser.parse_args()
    score = dict.fromkeys(PHYSICS, 0)
    for seed in range(wanted.seeds):
        for name in PHYSICS:
            right, line = one(name, wanted.rho, seed)
            score[name] += right
            print("right" if right else "WRONG", line, flush=True)
    print({name: f"{count} of {wanted.seeds}" for name, count in score.items()})
