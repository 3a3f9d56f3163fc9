"""Hansen's scheme on random loops in coloured noise, against its parts: refinement from the nominal plant alone, and PBSIDopt.

Plants of 2 to 6 states, 1 or 2 inputs and outputs, every third with feedthrough; the nominal model has poles and gains 5 to 20 % off; the controller is
LQG for the nominal model. Noise on the outputs is AR(1) with pole 0.9, at a share of the outputs' deviation. Error: median over frequency
of |G - G0| / |G0|. Coverage: share of 95 % ellipses that hold the true response; that of a single loop takes several
recordings, since the errors of neighbouring frequencies go together.

    python benchmarks/identify/random_loops.py --loops 24 --share 0.3 --recordings 1

With ``--keep FOLDER`` recordings and true plants are written there, and PARSIM-K of sippy runs on them (see `peers`):

    peers/bin/python benchmarks/identify/random_loops_peers.py FOLDER
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from drawn_plants import modes
from scipy.signal import lfilter

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.errors import AfdsvcError
from afdsvc.identify.methods.hansen import loop_is_stable, youla_signals
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.pipeline import identify
from afdsvc.identify.preparation import prepare_problem
from afdsvc.identify.reduction import refine
from afdsvc.identify.validation import hold_out
from afdsvc.lti.coprime import Factorisation, observer_factorisation
from afdsvc.lti.frequency import frequency_response
from afdsvc.lti.python_control import factorise
from afdsvc.lti.riccati import kalman_predictor_gain, lqr
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import closed_loop

SAMPLES, POLE = 6000, 0.9


def drawn(rng: np.random.Generator, feedthrough: bool) -> tuple[StateSpace, StateSpace, Factorisation]:
    """Return true plant, nominal plant and a controller that stabilises both."""
    while True:
        pairs, m, p = rng.integers(1, 4), rng.integers(1, 3), rng.integers(1, 3)
        radius, angle = rng.uniform(0.7, 0.97, pairs), rng.uniform(0.1, 2.0, pairs)
        B, C, D = rng.standard_normal((2 * pairs, m)), rng.standard_normal((p, 2 * pairs)), feedthrough * rng.standard_normal((p, m))
        true, nominal = (StateSpace(modes(r, a), g * B, C, D, 1.0) for r, a, g in (
            (radius, angle, 1.0), (radius * rng.uniform(0.9, 1.0, pairs), angle * rng.uniform(0.85, 1.15, pairs), rng.uniform(0.8, 1.2))))  # fmt: skip
        F = lqr(nominal, nominal.C.T @ nominal.C, 10 * np.eye(m))
        fact = observer_factorisation(nominal, F, kalman_predictor_gain(nominal, 0.1 * nominal.B @ nominal.B.T, np.eye(p)))
        if loop_is_stable(true, fact.controller):
            return true, nominal, factorise(nominal, fact.controller)


def recorded(rng: np.random.Generator, true: StateSpace, fact: Factorisation, share: float) -> Trace:
    """Return u, y, alpha and beta of the loop, excited by alpha, with noise of a share of the deviation that alpha causes in the outputs."""
    p, m = true.outputs, true.inputs
    alpha = np.repeat(rng.choice([-1.0, 1.0], (SAMPLES // 2, m)), 2, axis=0)
    system = closed_loop(fact, true).system
    inputs = np.hstack([np.zeros((SAMPLES, p)), np.zeros((SAMPLES, p + m)), alpha])
    moved = simulate(system, inputs)[0][:, p : 2 * p].std(axis=0)
    inputs[:, :p] = share * moved * np.sqrt(1 - POLE**2) * lfilter([1.0], [1.0, -POLE], rng.standard_normal((SAMPLES, p)), axis=0)
    out = simulate(system, inputs)[0]
    parts = {"y": out[:, p : 2 * p], "u": out[:, 2 * p : 2 * p + m], "beta": out[:, 2 * p + m :], "alpha": alpha}
    channels = [Channel(f"{role}_{('v' if role in 'beta y' else 'w')}{k}") for role, part in parts.items() for k in range(part.shape[1])]
    return Trace("loop", 1.0, tuple(channels), np.hstack(list(parts.values())))


def compared(seed: int, share: float, recordings: int, keep: Path | None = None) -> dict[str, float]:
    """Return the errors of one loop in the first recording, and the coverage of Hansen's bands over all of them."""
    rng = np.random.default_rng(seed)
    true, nominal, fact = drawn(rng, seed % 3 == 0)
    traces = [recorded(rng, true, fact, share) for _ in range(recordings)]
    if keep:
        parts = {role: np.column_stack([traces[0].column(c.name) for c in traces[0].channels if c.role == role]) for role in "uy"}
        np.savez(keep / f"{seed}.npz", **parts, A=true.A, B=true.B, C=true.C, D=true.D)
    names = [tuple(Variable(f"{c}{k}") for k in range(n)) for c, n in (("w", true.inputs), ("v", true.outputs), ("x", true.order))]
    model = Model("drawn", *names, nominal, sample_time=1.0, controller=fact.controller)
    fits = [identify(model, [trace], options=IdentifyOptions(cross_check=False)).fit for trace in traces]
    problem = prepare_problem(model, traces[:1], (), 100)
    training = hold_out(problem.training, problem.heldout).training
    alone = refine(problem.fact, [youla_signals(problem.fact, r).centred() for r in training], nominal).system
    options = IdentifyOptions(method="pbsid", order=true.order, groups=0, cross_check=False, feedthrough=False)
    direct = identify(model, traces[:1], options=options).fit.system
    omega = np.geomspace(0.02, 3.0, 80)
    truth = frequency_response(true, omega)

    def error(system: StateSpace) -> float:
        gap = np.linalg.norm(frequency_response(system, omega) - truth, 2, axis=(1, 2))
        return float(np.median(gap / np.linalg.norm(truth, 2, axis=(1, 2))))

    covered = [fit.band.covers(frequency_response(true, fit.band.omega)).mean() for fit in fits if fit.band is not None]
    return {"nominal": error(nominal), "hansen": error(fits[0].system), "refine": error(alone), "pbsid": error(direct), "coverage": float(np.mean(covered))}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=24)
    parser.add_argument("--share", type=float, default=0.3)
    parser.add_argument("--recordings", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    if args.keep:
        args.keep.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in range(args.loops):
        try:
            rows.append(compared(seed, args.share, args.recordings, args.keep))
        except (AfdsvcError, np.linalg.LinAlgError) as failure:
            print(f"{seed:3d} failed: {failure}", flush=True)
            continue
        print(f"{seed:3d}", *(f"{k} {100 * v:7.2f}" for k, v in rows[-1].items()), flush=True)
    worse = sum(r["hansen"] > r["nominal"] for r in rows)
    near = sum(r["hansen"] <= 1.1 * min(r["refine"], r["pbsid"]) for r in rows)
    coverage = [100 * r["coverage"] for r in rows]
    print(f"share {args.share}: {len(rows)} of {args.loops} identified; within 1.1 of the best: {near}; worse than nominal: {worse}; "
          f"median error {100 * np.median([r['hansen'] for r in rows]):.2f} % (refine {100 * np.median([r['refine'] for r in rows]):.2f} %, "
          f"PBSIDopt {100 * np.median([r['pbsid'] for r in rows]):.2f} %); coverage {np.mean(coverage):.1f} %, of single loops {min(coverage):.0f} to {max(coverage):.0f} %, 93 to 97 % on {sum(93 <= c <= 97 for c in coverage)}")  # fmt: skip
