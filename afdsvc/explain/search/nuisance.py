"""Unknown constant loads: a nuisance of every fit of a plant that integrates, where an offset of the sensor is none."""

from __future__ import annotations

from typing import Any

import numpy as np

from afdsvc.api.physics import Coefficient, Hypothesis, Signal
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import Nominal
from afdsvc.explain.simulate.predictor import driven
from afdsvc.lti.statespace import Array

NUISANCE = "nuisance"  # family of effects that are part of every hypothesis and have a prior: their scale is its standard deviation


def unknown_load(p: Any, z: Any, m: Any, dt: float, out: Any) -> None:
    """A constant force."""
    out[0] += p[0]


def loads(nominal: Nominal, force: Array, share: float) -> tuple[PlacedEffect, ...]:
    """Return a constant load on every driven state, zero at first, with a prior of ``share`` of the nominal force there."""
    found = []
    for i in np.flatnonzero(np.where(driven(nominal.model, nominal.plant.order), force, 0.0) > 0):
        name = nominal.model.states[i].name if i < len(nominal.model.states) else f"x{i}"
        size = Coefficient("load", "", -np.inf, np.inf, share * float(force[i]), linear=True)
        signal = Signal("x", int(i))
        found.append(PlacedEffect(Hypothesis(NUISANCE, f"state:{name}", NUISANCE, "force", unknown_load, (signal,), (signal,), (size,), ((0.0,),)), np.zeros(1)))
    return tuple(found)
