"""The modified Hansen scheme on an unstable plant: the turboexpander found anew, in closed loop, from one recording.

The machine has bearing stiffnesses 20 to 50 % off the model; noise of 0.5 um and unbalance of grade G2.5 are present, the
latter projected out by the rotor angle. Nothing but alpha, beta, the nominal model and its controller is used.

    python benchmarks/rotor/hansen.py --seconds 2
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from loop import full_plant, record, without_rotation

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.pipeline import identify
from afdsvc.identify.result import IdentifyResult
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.statespace import StateSpace
from afdsvc.plants.amb_turboexpander import NOISE_SD, amb_turboexpander
from afdsvc.plugins.controllers.lqg import Lqg

CHANGE = {"stiffness_a_x": 0.2, "stiffness_a_y": -0.2, "stiffness_b_x": -0.3, "stiffness_b_y": -0.5}
SETTLED = 3000  # samples
EXCITATION = 0.4  # A; moves the rotor by about 40 um, a third of the limit
BANDS = (np.geomspace(100, 400, 30), np.geomspace(400, 5000, 40))  # rad/s, below and above the unstable modes


def setting(seconds: float, seed: int, full: bool, noise: float) -> tuple[Model, list[Trace], StateSpace]:
    """Return the nominal model, two recordings and the true machine."""
    plant = amb_turboexpander()
    nominal = plant.discrete()
    fact = Lqg().design(nominal, plant.recommended["lqg"]).factorisation
    values = {name: plant.parameters[name].value * (1 + theta) for name, theta in CHANGE.items()}
    true = full_plant(plant.values(values), 31500, plant.sample_time) if full else plant.discrete(**values)
    model = Model(
        "turboexpander", plant.inputs, plant.outputs, plant.states, nominal, sample_time=nominal.dt,
        output_sd=np.full(4, NOISE_SD), controller=fact.K,
    )
    return model, [_trace(plant, fact, true, seconds, seed + k, noise) for k in range(2)], true


def _trace(plant, fact, true, seconds: float, seed: int, noise: float) -> Trace:
    rng, n = np.random.default_rng(seed), round(seconds / plant.sample_time) + SETTLED
    alpha = EXCITATION * np.repeat(rng.choice([-1.0, 1.0], size=(n // 5 + 1, 4)), 5, axis=0)[:n]
    run = record(true, fact, alpha, rng, noise, 31500)
    steady = slice(SETTLED, None)  # the whirl has settled: what turns with the rotor is one wave
    # from alpha too: what is projected out of all signals alike leaves the relations between them as they are
    signals = [without_rotation(s[steady], run.angle[steady]) for s in (run.u, run.y, alpha, run.beta)]
    names = [Channel(f"{role}_{v.name}", v.unit) for role, of in
             (("u", plant.inputs), ("y", plant.outputs), ("alpha", plant.inputs), ("beta", plant.outputs)) for v in of]
    return Trace(f"run {seed}", plant.sample_time, tuple(names), np.hstack(signals))


def error(system: StateSpace, true: StateSpace) -> list[float]:
    """Return the largest relative error of the response in each band."""
    pairs = [(frequency_response(system, w), frequency_response(true, w)) for w in BANDS]
    return [round(float((np.linalg.norm(a - b, 2, (1, 2)) / np.linalg.norm(b, 2, (1, 2))).max()), 3) for a, b in pairs]


def unstable(system: StateSpace) -> np.ndarray:
    """Return the unstable poles in rad/s, by size."""
    s = np.log(system.poles().astype(complex)) / system.dt
    return np.sort(s.real[s.real > 10])


def reported(result: IdentifyResult, model: Model, true: StateSpace) -> str:
    """Return the figures in words."""
    found = result.fit.system
    before, after = ([round(float(m[v.name].r2), 3) for v in model.outputs] for m in (result.before, result.after))
    return (
        f"loop stable {result.loop_stable}; response error {error(model.plant, true)} before, {error(found, true)} after (100 to 400, 400 to 5000 rad/s);\n"
        f"  growth rates [rad/s] true {unstable(true).round(0)}, model {unstable(model.plant).round(0)}, found {unstable(found).round(0)};\n"
        f"  R2 of held-out prediction {before} -> {after}; {result.warnings}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=2.0)
    wanted = parser.parse_args()
    for full, noise in ((False, 0.0), (True, NOISE_SD)):
        model, traces, true = setting(wanted.seconds, 1, full, noise)
        result = identify(model, traces[:1], traces[1:], IdentifyOptions(method="hansen", cross_check=False))
        print(f"{'320' if full else '8'} states, noise {noise} um: {reported(result, model, true)}", flush=True)
