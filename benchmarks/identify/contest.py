"""The methods of the Monte Carlo study and of table 4.1, side by side on the same recordings."""

from __future__ import annotations

import numpy as np
from bearing import PLANT, binary

from afdsvc.dataset.arrays import InputOutputData
from afdsvc.errors import AfdsvcError
from afdsvc.identify.methods.greybox import GreyboxOptions, fit_greybox
from afdsvc.identify.methods.hansen import excited_loop, rebuilt_plant
from afdsvc.identify.methods.subspace import decompose, realise
from afdsvc.identify.order import choose_order
from afdsvc.identify.parameters.structure import physical_structure
from afdsvc.identify.reduction import compare_reductions, refine
from afdsvc.identify.validation import heldout_measures
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

SAMPLES, OUTPUT_RMS, HORIZON = 2000, 2.0, 24
FREE = [n for n in PLANT.parameters if n != "mass"]
METHODS = ("nominal", "PEM", "PEM, 5 starts", "Hansen G(S)", "Hansen, truncated", "Hansen, refined", "truth")


def scaled_discrete(theta: float, plant=PLANT) -> StateSpace:
    true = plant.discrete()
    return StateSpace((1 - theta) * true.A, true.B, true.C, true.D, true.dt)


def scaled_continuous(theta: float, plant=PLANT) -> StateSpace:
    G = plant.continuous()
    return sample_zoh(StateSpace((1 - theta) * G.A, G.B, G.C, G.D, 0.0), plant.sample_time)


def amplitude(fact: Factorisation, true: StateSpace, rms: float = OUTPUT_RMS) -> float:
    """Return the amplitude of alpha that moves the outputs by the given root mean square."""
    probe = binary(np.random.default_rng(0), 4000, 1.0)
    y = simulate(excited_loop(fact, true), probe)[0][500:, 2:]
    return rms / float(np.sqrt((y**2).mean()))


def identify_all(
    fact: Factorisation, nominal: StateSpace, true: StateSpace, training: list[InputOutputData], signals: list[InputOutputData],
    theta: float, rng: np.random.Generator, plant=PLANT, start: Array | None = None, starts: bool = True,
) -> dict[str, StateSpace | None]:
    """Return the plant of every method, None where it failed."""
    structure = physical_structure(plant, FREE)
    start = structure.values * (1 - theta) if start is None else start
    found = {"nominal": nominal, "truth": true, "PEM": _pem(structure, training, GreyboxOptions(steps=25), rng, start)}
    if starts:
        found["PEM, 5 starts"] = _pem(structure, training, GreyboxOptions(starts=5, spread=3.0, steps=25), rng, start)
    try:
        found |= _hansen(fact, training, signals)
    except (AfdsvcError, np.linalg.LinAlgError) as error:
        print("Hansen failed at", theta, error, flush=True)
    return found


def _pem(structure, training, options, rng, start) -> StateSpace | None:
    try:
        return fit_greybox(structure, training, options, rng, start).system
    except (AfdsvcError, np.linalg.LinAlgError):
        return None


def _hansen(fact: Factorisation, training: list[InputOutputData], signals: list[InputOutputData]) -> dict[str, StateSpace | None]:
    order = max(choose_order(signals, HORIZON, 16).order, 2)
    full = rebuilt_plant(fact, realise(decompose(signals, HORIZON), order, stable=True).system)
    truncated = compare_reductions(full, fact, 6, training)[0].system
    refined = refine(fact, signals, truncated).system
    return {"Hansen G(S)": full, "Hansen, truncated": truncated, "Hansen, refined": refined}


def r2(system: StateSpace | None, heldout: InputOutputData) -> list[float]:
    """Return Eq 4.38 of the thesis for both outputs: NaN where there is no model, -1 where it cannot be simulated."""
    if system is None:
        return [float("nan")] * 2
    try:
        return [m.r2 for m in heldout_measures(system, [heldout])]
    except AfdsvcError:
        return [-1.0, -1.0]
