"""What a machine of a field trial is recorded under: files, excitation, noise, drift, resolution, errors of the catalogue."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from afdsvc.trial.field.excitation import ONCE, REPEATING
from afdsvc.trial.field.plants import IMPOSED
from afdsvc.trial.field.rig import Rig, spread

LARGEST, SMALLEST = 20_000, 500  # samples of a file
LONG_ENOUGH = 15  # times tau that a file lasts at least
COLOURED, DRIFTING = 0.5, 0.4  # shares of the trials


@dataclass(frozen=True, slots=True)
class Conditions:
    """Circumstances of a trial; sizes are relative to the rms of the outputs (``push``: of what drives the axis).

    ``files`` recordings of ``samples`` each are given, the last one is the holdout. ``white`` and ``coloured`` are noise of
    the sensors, ``colour`` the pole per sample of the latter, ``push`` noise that drives the states. ``drift`` is the rms of a
    slow wander of the reading. ``resolution`` is one step of the reading (0: none). ``wrong`` is the standard deviation of the
    constants' errors, ``stated`` the one in the MODEL.toml (0: not stated there). ``running`` says that the machine was moving
    when the recording began, ``offset`` the reading and command at the operating point.
    """

    excitation: str
    repeating: bool
    files: int
    samples: tuple[int, ...]
    levels: tuple[float, ...]
    white: float
    coloured: float
    colour: float
    push: float
    drift: float
    resolution: float
    wrong: float
    stated: float
    running: bool
    offset: float
    aux: bool

    def as_json(self) -> dict[str, Any]:
        """Return the conditions as plain values."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def conditions(rig: Rig, nothing: bool, repeating: bool, g: np.random.Generator) -> Conditions:
    """Return drawn conditions; with ``nothing`` hidden noise is coloured, the stated uncertainty honest and drift below noise."""
    files = int(g.integers(2, 6))
    shortest = max(SMALLEST, round(LONG_ENOUGH * rig.tau / rig.dt))
    samples = tuple(int(np.clip(spread(g, shortest, 4 * shortest), SMALLEST, LARGEST)) for _ in range(files))
    white, wrong = spread(g, 0.002, 0.05), float(g.choice([0.05, 0.1, 0.2]))
    coloured = spread(g, 0.01, 0.08) if nothing or g.random() < COLOURED else 0.0
    honest = nothing or g.random() < 0.6
    stated = wrong if honest else wrong / 4
    drift = spread(g, 0.3, 1.0) * (white if nothing else 0.03) if g.random() < DRIFTING else 0.0
    return Conditions(
        excitation="free_decay" if not rig.inputs else _excitation(rig, repeating, g), repeating=repeating and bool(rig.inputs),
        files=files, samples=samples, levels=tuple(float(g.uniform(0.5, 1.0)) for _ in range(files)), white=white,
        coloured=coloured, colour=float(g.uniform(0.85, 0.995)), push=spread(g, 0.003, 0.03) if g.random() < 0.5 else 0.0,
        drift=drift, resolution=spread(g, 0.3, 3.0) * white if g.random() < 0.4 else 0.0, wrong=wrong,
        stated=0.0 if not nothing and abs(stated - 0.05) < 0.03 and g.random() < 0.5 else stated, running=bool(g.random() < 0.5),
        offset=spread(g, 1.0, 5.0) if rig.offsets and g.random() < 0.5 else 0.0, aux=bool(g.random() < 0.25),
    )


def _excitation(rig: Rig, repeating: bool, g: np.random.Generator) -> str:
    if rig.plant == IMPOSED:  # what an exciter can move by
        return "multisine" if repeating else str(g.choice(["chirp", "operation"]))
    kinds = [k for k in (REPEATING if repeating else ONCE) if k != "relay" or relay_fits(rig)]
    return str(g.choice(kinds))


def relay_fits(rig: Rig) -> bool:
    """Return whether a relay makes the machine oscillate: one input, no controller, a rising static gain."""
    return rig.family in ("servo", "arm", "tanks", "stores")
